use super::entry::{NodeEntry, Twin};
use super::node::tests::STATUS;
use super::*;
use crate::config::PresenceConfig;
use albireo_service::clock::{Now, Uptime};
use albireo_wire::{HealthState, HealthStatus, Heartbeat, NodeStatus, StatusMessage, VERSION};
use serde_json::json;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A node whose last status was received some time ago.
#[derive(Debug)]
struct Heard {
    ago: Option<Duration>,
    entry: NodeEntry,
}

impl Heard {
    fn well(seconds_ago: u64) -> Self {
        let mut entry = NodeEntry::new("a", 0);
        entry.health = HealthState::Ready;
        Self {
            ago: Some(Duration::from_secs(seconds_ago)),
            entry,
        }
    }

    fn never() -> Self {
        Self {
            ago: None,
            ..Self::well(0)
        }
    }

    /// Heard a second ago, with the reason of a part if there is one.
    fn ill(health: HealthState, reason: Option<&str>) -> Self {
        let mut heard = Self::well(1);
        heard.entry.health = health;
        let reasons = reason.map(|reason| ("part".to_owned(), reason.to_owned()));
        heard.entry.node.status = Some(Arc::new(NodeStatus {
            health: HealthStatus {
                state: health,
                reasons: reasons.into_iter().collect(),
            },
            ..STATUS.clone()
        }));
        heard
    }

    fn with_twin(mut self) -> Self {
        self.entry.twin = Some(Twin {
            why: "twins".to_owned(),
            until: Instant::now(),
        });
        self
    }

    fn without_token(mut self) -> Self {
        self.entry.token_gone = true;
        self
    }
}

#[test]
fn the_state_follows_the_table_in_the_documentation() {
    use HealthState::{Degraded as Bad, NotReady};
    use PresenceState::{Degraded, Offline, Online, Silent};
    let gone = "its liveliness token disappeared: it stopped, or its connection broke";
    for (heard, state, why) in [
        (Heard::never(), Silent, "no status was received yet"),
        (Heard::well(0), Online, ""),
        (Heard::well(94), Online, ""),
        (Heard::well(95), Silent, "no status for 95 s"),
        (Heard::well(599), Silent, "no status for 95 s"),
        (Heard::well(600), Offline, "no status for 600 s"),
        (Heard::well(1).without_token(), Offline, gone),
        (Heard::ill(Bad, Some("why")), Degraded, "part: why"),
        (Heard::ill(Bad, None), Degraded, "a part does not work"),
        (
            Heard::ill(NotReady, None),
            Degraded,
            "it does not answer frames",
        ),
        (Heard::well(1).with_twin(), Degraded, "twins"),
        (Heard::ill(Bad, Some("why")).with_twin(), Degraded, "twins"),
        (Heard::well(95).with_twin(), Silent, "no status for 95 s"),
    ] {
        let expected = (state, why.to_owned());
        let found = heard.entry.judge(heard.ago, 95.0, 600.0);
        assert_eq!(found, expected, "{heard:?}");
    }
}

/// So many seconds after `start`.
fn after(start: Instant, seconds: u64) -> Now {
    Now {
        at: start + Duration::from_secs(seconds),
        unix_ms: seconds.cast_signed() * 1000,
        uptime: Uptime::default(),
    }
}

fn life(seq: u64) -> StatusMessage {
    let status = json!({
        "v": VERSION, "run": 7, "started_ns": 1, "seq": seq, "t_ns": 0, "health": "ready", "waiting": 0, "revision": 0,
    });
    serde_json::from_value(status).unwrap()
}

#[test]
fn a_node_silent_at_a_hub_restart_becomes_offline_in_time_and_returns() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let remembered = json!({
        "node": "a", "state": "silent", "since_ms": 100_000, "why": "no status for 95 s", "heard_ms": 5_000,
        "waiting": 0, "revision": 0, "today": TodaysEnergy::default(),
    });
    let remembered = serde_json::from_value(remembered).unwrap();
    let start = Instant::now();
    fleet.remember(vec![remembered], start);
    let state = || fleet.view("a").unwrap().state;
    let at = |seconds, unix_ms| Now {
        unix_ms,
        ..after(start, seconds)
    };
    fleet.sweep(at(1, 200_000));
    assert_eq!(state(), PresenceState::Silent);
    fleet.sweep(at(2, 700_000));
    assert_eq!(state(), PresenceState::Offline);
    assert_eq!(fleet.view("a").unwrap().since_ms, 700_000);
    fleet.apply_status("a", life(0), at(3, 701_000));
    assert_eq!(state(), PresenceState::Online);
}

#[test]
fn a_name_that_no_node_may_have_now_is_not_remembered() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let named = |node: &str| NodeView {
        node: node.to_owned(),
        ..NodeView::default()
    };
    fleet.remember(["..", "all", "car-1"].map(named).to_vec(), Instant::now());
    let names: Vec<String> = fleet.views(|_| true).into_iter().map(|node| node.node).collect();
    assert_eq!(names, ["car-1"]);
}

#[test]
fn a_restart_is_no_conflict_but_two_nodes_with_the_same_name_are_reported() {
    use PresenceState::{Degraded, Online};
    let fleet = Fleet::new(&PresenceConfig::default());
    for (run, state) in [(7, Online), (8, Online), (7, Degraded)] {
        let status = StatusMessage { run, ..life(0) };
        fleet.apply_status("a", status, Now::system());
        assert_eq!(fleet.view("a").unwrap().state, state);
    }
    let why = fleet.view("a").unwrap().why;
    assert!(why.starts_with("two nodes have this name"), "{why}");
}

#[test]
fn a_notice_for_a_lost_status_is_sent_at_most_every_few_seconds() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    assert!(fleet.apply_status("a", life(0), after(start, 0)));
    assert!(!fleet.apply_status("a", life(3), after(start, 1)));
    assert!(fleet.apply_status("a", life(9), after(start, 6)));
    assert!(fleet.needs_full_status("a"));
}

#[test]
fn a_message_that_a_later_one_overtook_changes_nothing() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    let full = |message: StatusMessage| StatusMessage {
        full: Some(Box::new(STATUS.clone())),
        ..message
    };
    let ill = |seq| StatusMessage {
        health: HealthState::Degraded,
        revision: 7,
        waiting: 9,
        ..life(seq)
    };
    fleet.apply_status("a", full(life(0)), after(start, 0));
    // After a gap, and after the full status that was then requested.
    for (newest, is_full_missing) in [(life(5), true), (full(life(8)), false)] {
        let run = newest.run;
        let seq = newest.seq - 1;
        let waiting = 9;
        fleet.apply_status("a", newest, after(start, 1));
        let before = fleet.view("a");
        fleet.apply_status("a", ill(seq), after(start, 2));
        fleet.apply_status("a", full(ill(seq)), after(start, 2));
        fleet.alive("a", Heartbeat { run, seq, waiting }, after(start, 2));
        assert_eq!(fleet.view("a"), before);
        assert_eq!(fleet.needs_full_status("a"), is_full_missing);
    }
}

#[test]
fn a_process_that_starts_again_under_its_old_number_is_heard_and_is_no_second_node() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    for started_ns in 1..=4 {
        for seq in 0..3 {
            let waiting = 10 * started_ns + seq;
            let status = StatusMessage {
                started_ns,
                waiting,
                full: Some(Box::new(STATUS.clone())),
                ..life(seq)
            };
            fleet.apply_status("a", status, after(start, waiting));
            let view = fleet.view("a").unwrap();
            assert_eq!(view.waiting, waiting);
            assert_eq!(view.state, PresenceState::Online);
            assert!(!fleet.needs_full_status("a"));
        }
    }
}

#[test]
fn one_stray_number_mutes_no_node() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    let with = |seq, waiting| StatusMessage {
        waiting,
        full: Some(Box::new(STATUS.clone())),
        ..life(seq)
    };
    fleet.apply_status("a", with(0, 1), after(start, 0));
    for (number, stray) in (0..).zip([200, u64::MAX]) {
        fleet.apply_status("a", life(stray), after(start, 1));
        let seq = 2 * number + 1;
        let heartbeat = Heartbeat {
            run: life(seq).run,
            seq,
            waiting: 5,
        };
        fleet.alive("a", heartbeat, after(start, 2));
        assert_eq!(fleet.view("a").unwrap().waiting, 5, "{stray}");
        assert!(fleet.needs_full_status("a"));
        fleet.apply_status("a", with(seq + 1, 6), after(start, 3));
        assert_eq!(fleet.view("a").unwrap().waiting, 6, "{stray}");
        assert!(!fleet.needs_full_status("a"));
    }
}

#[test]
fn a_heartbeat_confirms_the_last_status_of_its_run_and_another_run_requests_the_full_status() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    let at = |seconds| after(start, seconds);
    let first = StatusMessage {
        health: HealthState::Degraded,
        revision: 7,
        full: Some(Box::new(STATUS.clone())),
        ..life(0)
    };
    let run = first.run;
    let waiting = 3;
    assert!(!fleet.apply_status("a", first, at(0)));
    let sign = |seq| Heartbeat { run, seq, waiting };
    assert!(!fleet.alive("a", sign(1), at(90)));
    fleet.sweep(at(180));
    let view = fleet.view("a").unwrap();
    // It was heard 90 s ago, so its state stays.
    assert_eq!(view.state, PresenceState::Degraded);
    assert_eq!(view.waiting, 3);
    assert_eq!(view.revision, 7);
    // A status was lost.
    assert!(fleet.alive("a", sign(3), at(181)));
    assert!(fleet.needs_full_status("a"));
    // The hub knows nothing of another run, and does not mistake it for this one.
    let other = Heartbeat {
        run: run + 1,
        ..sign(0)
    };
    assert!(fleet.alive("a", other, at(200)));
    assert!(fleet.alive("b", other, at(200)));
    assert_eq!(fleet.view("b").unwrap().state, PresenceState::Silent);
}

#[test]
fn in_a_large_fleet_heartbeats_are_rarer_and_silence_and_twins_are_told_later() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    let at = |seconds| after(start, seconds);
    for node in 0..12_000 {
        fleet.apply_status(&node.to_string(), life(0), at(0));
    }
    for (seconds, state) in [(189, PresenceState::Online), (191, PresenceState::Silent)] {
        fleet.sweep(at(seconds));
        assert_eq!(fleet.heartbeat_s(), 60);
        assert_eq!(fleet.view("7").unwrap().state, state);
    }
    for (run, seconds) in [(8, 300), (7, 360), (8, 420)] {
        fleet.apply_status("7", StatusMessage { run, ..life(0) }, at(seconds));
    }
    assert_eq!(fleet.view("7").unwrap().state, PresenceState::Degraded);
}

#[test]
fn invented_names_fill_no_memory_and_nodes_that_report_are_shown() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let now = Now::system();
    for name in 0..100_001 {
        fleet.apply_status(&format!("invented-{name}"), life(0), now);
    }
    assert_eq!(fleet.dropped_statuses().names, 1);
    assert!(fleet.view("invented-100000").is_none());
    let fault = fleet.fault().unwrap();
    assert!(
        fault.reason.contains("names have sent a status"),
        "{fault:?}"
    );
    fleet.reported("invented-100000", now.unix_ms);
    fleet.apply_status("invented-100000", life(0), now);
    assert!(fleet.view("invented-100000").is_some());
    // A name that reported makes no room for others.
    fleet.reported("invented-0", now.unix_ms);
    fleet.apply_status("another", life(0), now);
    assert!(fleet.view("another").is_some());
    assert_eq!(fleet.dropped_statuses().names, 1);
}

#[test]
fn large_statuses_of_invented_names_fill_no_memory() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let now = Now::system();
    let large = |seq| StatusMessage {
        full: Some(Box::new(NodeStatus {
            version: "v".repeat(60_000),
            ..STATUS.clone()
        })),
        ..life(seq)
    };
    for name in 0..3_000 {
        fleet.apply_status(&format!("invented-{name}"), large(0), now);
    }
    let mut kept = 0_u64;
    fleet.each(|node| {
        if node.status.is_some() {
            kept += 1;
        }
    });
    // 64 MB of 60 kB.
    assert!((1_000..1_200).contains(&kept), "{kept}");
    assert_eq!(fleet.dropped_statuses().memory, 3_000 - kept);
    assert!(fleet.fault().is_some());
    // Its state is known all the same, and the status is kept once it reports: real nodes bring their own room.
    let last = fleet.view("invented-2999").unwrap();
    assert_eq!(last.state, PresenceState::Online);
    for name in 0..3_000 {
        fleet.reported(&format!("invented-{name}"), now.unix_ms);
    }
    assert!(fleet.needs_full_status("invented-2999"));
    fleet.apply_status("invented-2999", large(1), now);
    assert!(fleet.view("invented-2999").unwrap().status.is_some());
}

#[test]
fn a_name_without_a_report_is_a_stranger_after_a_week_offline_unless_it_is_expected() {
    let fleet = Fleet::new(&PresenceConfig::default());
    let start = Instant::now();
    let full = |status: NodeStatus| StatusMessage {
        full: Some(Box::new(status)),
        ..life(0)
    };
    let expected = NodeStatus {
        labels: [("expected".to_owned(), "always".to_owned())].into(),
        ..STATUS.clone()
    };
    fleet.apply_status("invented", full(STATUS.clone()), after(start, 0));
    fleet.apply_status("fixed", full(expected), after(start, 0));
    fleet.apply_status("car", full(STATUS.clone()), after(start, 0));
    fleet.reported("car", 0);
    fleet.sweep(after(start, 3_600));
    let week_ms = 7 * 86_400_000;
    assert!(fleet.strangers(10, week_ms).is_empty());
    let found = fleet.strangers(10, week_ms + 3_600_000);
    assert_eq!(found, ["invented"]);
}
