//! Sets a node's clock before, between and after sending: no report is refused, lost or stored twice.

use super::Output;
use super::hub::{Asker, Hub};
use super::node::Node;
use super::timeline::{DAY, HOUR, SECOND, Timeline, folder};
use albireo_hub::ingest::decode;
use albireo_service::clock::Now;
use albireo_wire::BatchCompression;
use proptest::prelude::*;

/// What happens between two clips.
#[derive(Clone, Debug)]
enum Step {
    /// The clock is set, to so many milliseconds ahead.
    Clock(i64),
    /// The program is started again.
    Restart,
    /// The machine is started again.
    Reboot,
    /// Time passes.
    Pass(i64),
    /// A batch is sent, and lost, stored without an answer, or answered.
    Send(Fate),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Lost,
    Unanswered,
    Answered,
}

const YEAR: i64 = 365 * DAY;

/// The only process of the hub.
const PROCESS: usize = 0;

struct Bench {
    time: Timeline<()>,
    hub: Hub,
    node: Node,
    made: usize,
    refused: Vec<usize>,
    _folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = folder();
        let time = Timeline::new(0, Output::Silent);
        let mut hub = Hub::new(folder.path());
        hub.switch_on(PROCESS, time.now());
        let mut bench = Self {
            node: Node::new("node-0".to_owned(), folder.path().join("state"), None),
            time,
            hub,
            made: 0,
            refused: Vec::new(),
            _folder: folder,
        };
        bench.node.switch_on(bench.now(), 1);
        bench
    }

    /// The present by the clocks of the node.
    fn now(&self) -> Now {
        self.time.now_of(self.node.clock_ms, self.node.boot)
    }

    fn make(&mut self) {
        let now = self.now();
        self.node.make(self.made, self.made as u16, now);
        self.made += 1;
        self.time.now_ms += SECOND;
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Clock(clock_ms) => self.node.clock_ms = *clock_ms,
            Step::Pass(ms) => self.time.now_ms += ms,
            Step::Restart => self.node.end(),
            Step::Reboot => drop(self.node.crash()),
            Step::Send(fate) => self.send(*fate),
        }
        if !self.node.is_on() {
            let now = self.now();
            self.node.switch_on(now, 1);
        }
    }

    fn send(&mut self, fate: Fate) {
        // Longer than any pause after a failure.
        self.time.now_ms += HOUR;
        let question = self.time.number();
        let now = self.now();
        let Some(batch) = self.node.poll(question, now).and_then(|polled| polled.batch) else {
            return;
        };
        let mut reply = Err(b"no reply".to_vec());
        if fate != Fate::Lost {
            let payload = batch.to_payload(BatchCompression::Quick).unwrap();
            let hub_now = self.time.now();
            let batch = decode(&self.node.name, &payload.into(), hub_now.unix_ms).unwrap();
            let from = Asker { node: 0, question };
            self.hub.take(PROCESS, from, batch);
            let (_, answer) = self.hub.commit(PROCESS, hub_now).pop().unwrap();
            if fate == Fate::Answered {
                reply = answer;
            }
        }
        let now = self.now();
        let refused = self.node.take(question, &reply, now);
        self.refused.extend(refused);
    }

    fn run(steps: &[Step]) {
        let mut bench = Self::new();
        for step in steps {
            bench.make();
            bench.step(step);
        }
        bench.make();
        for _ in 0..3 {
            bench.send(Fate::Answered);
        }
        assert!(bench.node.is_settled(), "{:?}", bench.node.counts());
        let stored = bench.hub.stored();
        let times: Vec<_> = (0..bench.made).map(|one| stored.get(&one).copied()).collect();
        assert_eq!(
            times,
            vec![Some(1); bench.made],
            "refused: {:?}",
            bench.refused
        );
        assert!(bench.refused.is_empty(), "refused: {:?}", bench.refused);
        bench.hub.check();
    }
}

#[test]
fn reports_made_with_a_clock_behind_are_stored_once_the_clock_is_right() {
    for days in [1, 29, 30, 31, 45, 100, 330, 331, 332, 1100] {
        for restart in [Step::Pass(1), Step::Restart, Step::Reboot] {
            for fate in [Fate::Lost, Fate::Unanswered, Fate::Answered] {
                let clock = -days * DAY;
                Bench::run(&[Step::Clock(clock), restart.clone(), Step::Clock(0)]);
                let sent = [
                    Step::Clock(clock),
                    Step::Send(fate),
                    restart.clone(),
                    Step::Clock(0),
                ];
                Bench::run(&sent);
            }
        }
    }
}

#[test]
fn clips_made_before_the_clock_was_set_are_stored_under_the_time_when_they_began() {
    for clock in [-56 * YEAR, -45 * DAY, -2 * HOUR, 3 * YEAR] {
        let mut bench = Bench::new();
        bench.step(&Step::Clock(clock));
        let mut began = Vec::new();
        for _ in 0..3 {
            began.push(bench.time.now().unix_ms);
            bench.make();
            bench.step(&Step::Pass(HOUR));
        }
        // The program may end in between: the steady clock is the machine's.
        bench.step(&Step::Restart);
        bench.step(&Step::Clock(0));
        bench.send(Fate::Answered);
        let dates = bench.hub.dates();
        assert_eq!(dates.len(), began.len());
        for (number, began) in began.into_iter().enumerate() {
            let off = dates[&number] - began;
            assert!(off.abs() <= SECOND, "clock {clock}: {off} ms");
        }
    }
}

fn step() -> impl Strategy<Value = Step> {
    // Near the limits of a hub, and anywhere.
    let clock = prop_oneof![-400 * DAY..400 * DAY, -60 * YEAR..60 * YEAR, Just(0)];
    let fate = prop_oneof![
        Just(Fate::Lost),
        Just(Fate::Unanswered),
        Just(Fate::Answered)
    ];
    prop_oneof![
        4 => clock.prop_map(Step::Clock),
        1 => Just(Step::Restart),
        1 => Just(Step::Reboot),
        // Less than the time for which a hub knows ids, all together.
        1 => (0..2 * DAY).prop_map(Step::Pass),
        4 => fate.prop_map(Step::Send),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_step_of_a_clock_refuses_or_doubles_a_report(steps in prop::collection::vec(step(), 1..12)) {
        Bench::run(&steps);
    }
}
