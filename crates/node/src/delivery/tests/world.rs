//! Plays the events of nodes and a hub in order of virtual time.

use super::hub::{Asker, Hub, Reply};
use super::node::{Node, put, serial};
use super::timeline::{DAY, HOUR, Payload, SECOND, Timeline, folder};
use super::{Output, holds};
use crate::outbox::OutboxCounts;
use albireo_hub::ingest::decode;
use albireo_service::clock::Now;
use albireo_wire::{BatchCompression, ReportBatch};
use std::collections::BTreeSet;
use std::rc::Rc;
use tempfile::TempDir;

/// Once nothing fails any more, everything is delivered within this time.
const SETTLED_WITHIN: i64 = 48 * HOUR;
const MOST_NODES: usize = 5;

const FAULTS: [&str; 12] = [
    "node loses power",
    "node's disk is full",
    NODE_CLOCK,
    "a bit of a node's files flips",
    "node's state is restored",
    "node's state is copied",
    "node's state is copied under its name",
    "hub is killed",
    "hub's disk is full",
    HUB_CLOCK,
    "hub is put back from a backup",
    "network is cut",
];
const NODE_CLOCK: &str = "node's clock is set";
const HUB_CLOCK: &str = "hub's clock is set";

#[derive(Clone, Debug)]
enum Event {
    Clip(usize),
    Poll(usize),
    Batch(Asker, Sent),
    Commit(usize),
    Reply(Asker, Payload<Reply>),
    NodeOn(usize),
    HubOn(usize),
    NodeDiskFree(usize),
    HubDiskFree,
    KeepNode(usize),
    BackUp,
    Fault,
    End,
}

/// A batch on its way. It becomes a payload only where a hub receives it.
#[derive(Clone)]
struct Sent(Rc<ReportBatch>);

impl std::fmt::Debug for Sent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let reports = self.0.reports.iter().map(|report| serial(report.id));
        f.debug_list().entries(reports).finish()
    }
}

pub(super) struct World {
    time: Timeline<Event>,
    end_ms: i64,
    folder: TempDir,
    nodes: Vec<Node>,
    hub: Hub,
    reports: usize,
    /// Reports lost with whatever held them, or refused by the hub by name: stored at most once.
    excused: BTreeSet<usize>,
    /// The fault that may set a clock by months or years. With both clocks off at once, nobody could tell what is old.
    far_clock: &'static str,
    /// Reports that the hub lost when its backup was restored.
    forgotten: BTreeSet<usize>,
    /// The number of flipped bits.
    flips: u64,
    /// Reports that a flipped bit may have damaged.
    damaged: BTreeSet<usize>,
    /// True if a node's state was restored after a flip.
    losses_are_rewound: bool,
    /// True if a node's state was damaged, restored or copied, or its counts were not on the disk.
    is_rewound: bool,
}

impl World {
    fn new(seed: u64, output: Output) -> Self {
        let folder = folder();
        let mut world = Self {
            time: Timeline::new(seed, output),
            end_ms: 0,
            nodes: Vec::new(),
            hub: Hub::new(folder.path()),
            folder,
            reports: 0,
            excused: BTreeSet::new(),
            far_clock: "",
            forgotten: BTreeSet::new(),
            flips: 0,
            damaged: BTreeSet::new(),
            losses_are_rewound: false,
            is_rewound: false,
        };
        world.end_ms = world.time.between(HOUR, 4 * HOUR);
        for _ in 0..world.time.below(3) + 1 {
            let name = format!("node-{}", world.nodes.len());
            world.add_node(name, None);
        }
        let processes = if world.time.chance(300) { 2 } else { 1 };
        for process in 0..processes {
            world.time.after(0, Event::HubOn(process));
        }
        for _ in 0..world.time.below(12) {
            world.time.sometime(0, world.end_ms, Event::Fault);
        }
        for at in 0..world.nodes.len() {
            world.time.sometime(0, world.end_ms, Event::KeepNode(at));
        }
        world.far_clock = world.time.one_of(&["", NODE_CLOCK, HUB_CLOCK]);
        // The hub asks for what it forgot within the week for which nodes keep it, by their own clocks.
        if world.far_clock != NODE_CLOCK {
            world.time.sometime(0, world.end_ms, Event::BackUp);
        }
        world.time.after(world.end_ms, Event::End);
        world
    }

    pub(super) fn run(seed: u64, output: Output) -> String {
        let mut world = Self::new(seed, output);
        while !(world.time.is_calm && world.is_settled()) {
            let event = world.time.next();
            world.handle(event);
            let is_late = world.time.now_ms > world.end_ms + SETTLED_WITHIN;
            holds("everything is delivered in the end", !is_late, || {
                let counts: Vec<_> = world.nodes.iter().map(Node::counts).collect();
                format!("{counts:?}")
            });
        }
        world.check();
        world.time.trace()
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Clip(at) => {
                if self.time.unlucky(5) {
                    return self.node_crash(at);
                }
                self.make(at);
                if self.time.unlucky(5) {
                    return self.node_crash(at);
                }
                if !self.time.is_calm {
                    self.time.sometime(60 * SECOND, 900 * SECOND, Event::Clip(at));
                }
            }
            Event::Poll(at) => {
                if self.nodes[at].looks_at_ms == Some(self.time.now_ms) {
                    self.nodes[at].looks_at_ms = None;
                    self.poll(at);
                }
            }
            Event::Batch(from, Sent(batch)) => {
                let process = self.one_process();
                if self.hub.is_on(process) {
                    let payload = batch.to_payload(BatchCompression::Quick).unwrap();
                    let payload = Payload(Rc::new(payload));
                    self.time.note(&payload);
                    let now = self.now_at_hub(process);
                    let name = &self.nodes[from.node].name;
                    let received = payload.0.to_vec().into();
                    let batch = decode(name, &received, now.unix_ms).unwrap();
                    self.hub.take(process, from, batch);
                    self.time.after(100, Event::Commit(process));
                }
            }
            Event::Commit(process) => self.commit(process),
            Event::Reply(Asker { node: at, question }, reply) => {
                if self.time.unlucky(10) {
                    return self.node_crash(at);
                }
                let now = self.now_at(at);
                let refused = self.nodes[at].take(question, &reply.0, now);
                let is_right = refused.is_empty() || self.is_rewound || self.far_clock == HUB_CLOCK;
                holds(
                    "no clock of a node makes a hub refuse a report",
                    is_right,
                    || format!("reports {refused:?} of node {at}"),
                );
                self.excused.extend(refused);
                self.poll(at);
                if self.time.unlucky(10) {
                    self.node_crash(at);
                }
            }
            Event::NodeOn(at) => self.node_on(at),
            Event::HubOn(process) => {
                self.hub.switch_on(process, self.now_at_hub(process));
            }
            Event::NodeDiskFree(at) => self.nodes[at].faults.free_disk(),
            Event::HubDiskFree => self.hub.file.free(),
            Event::KeepNode(at) => self.nodes[at].keep_state(),
            Event::BackUp => self.hub.file.back_up(),
            Event::Fault => self.fault(),
            Event::End => self.heal(),
        }
    }

    fn add_node(&mut self, name: String, state: Option<&[u8]>) {
        let at = self.nodes.len();
        let folder = self.folder.path().join(format!("state-{at}"));
        self.nodes.push(Node::new(name, folder, state));
        self.node_on(at);
    }

    fn node_on(&mut self, at: usize) {
        if !self.nodes[at].is_on() {
            let now = self.now_at(at);
            let random = self.time.random();
            self.nodes[at].switch_on(now, random);
            self.note_counts(at);
            self.poll(at);
            self.time.sometime(SECOND, 600 * SECOND, Event::Clip(at));
        }
    }

    /// The present by the clocks of a node.
    fn now_at(&self, at: usize) -> Now {
        let node = &self.nodes[at];
        self.time.now_of(node.clock_ms, node.boot + ((at as u64) << 32))
    }

    /// The present by the clock of a process of the hub.
    fn now_at_hub(&self, process: usize) -> Now {
        self.time.now_by(self.hub.processes[process].clock_ms)
    }

    /// One of the hub's processes: the first, if the second is off.
    fn one_process(&mut self) -> usize {
        if self.hub.is_on(1) && self.time.chance(500) {
            1
        } else {
            0
        }
    }

    /// After a power cut, running counts that were not on the disk are missing or given again.
    fn note_counts(&mut self, at: usize) {
        if !self.nodes[at].is_durable() {
            self.is_rewound = true;
            self.excuse(BTreeSet::new());
        }
    }

    fn make(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            let now = self.now_at(at);
            let random = self.time.random();
            let number = self.reports;
            self.reports += 1;
            self.time.note(&format!("node {at} makes report {number}"));
            self.nodes[at].make(number, random as u16, now);
            self.poll(at);
        }
    }

    fn poll(&mut self, at: usize) {
        let question = self.time.number();
        let now = self.now_at(at);
        let Some(next) = self.nodes[at].poll(question, now) else {
            return;
        };
        if let Some(batch) = next.batch {
            let asker = Asker { node: at, question };
            self.time.send(&Event::Batch(asker, Sent(batch)));
            let unanswered = Payload(Rc::new(Err(b"no reply".to_vec())));
            self.time.after(10 * SECOND, Event::Reply(asker, unanswered));
        }
        let pause_ms = (next.pause.as_millis() as i64).max(1);
        let at_ms = self.time.now_ms + pause_ms;
        let looks_at_ms = &mut self.nodes[at].looks_at_ms;
        if looks_at_ms.is_none_or(|looks_at_ms| at_ms < looks_at_ms) {
            *looks_at_ms = Some(at_ms);
            self.time.after(pause_ms, Event::Poll(at));
        }
    }

    fn commit(&mut self, process: usize) {
        if self.time.unlucky(15) {
            return self.hub_crash(process);
        }
        let replies = self.hub.commit(process, self.now_at_hub(process));
        if self.time.unlucky(15) {
            return self.hub_crash(process);
        }
        for (to, reply) in replies {
            self.time.send(&Event::Reply(to, Payload(Rc::new(reply))));
        }
    }

    fn node_crash(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            self.time.note(&format!("power of node {at} goes"));
            self.note_counts(at);
            let lost = self.nodes[at].crash();
            self.excused.extend(lost);
            self.time.sometime(SECOND, HOUR / 6, Event::NodeOn(at));
        }
    }

    fn hub_crash(&mut self, process: usize) {
        if self.hub.is_on(process) {
            self.time.note(&format!("hub {process} is killed"));
            self.hub.crash(process);
            self.time.sometime(SECOND, HOUR / 6, Event::HubOn(process));
        }
    }

    fn fault(&mut self) {
        let at = self.time.below(self.nodes.len() as u64) as usize;
        let process = self.one_process();
        let fault = self.time.one_of(&FAULTS);
        let lasts = self.time.between(SECOND, HOUR / 2);
        self.time.note(&format!("{fault} (node {at})"));
        match fault {
            "node loses power" => self.node_crash(at),
            "node's disk is full" => {
                self.nodes[at].faults.fill_disk();
                self.time.after(lasts, Event::NodeDiskFree(at));
            }
            NODE_CLOCK => self.nodes[at].clock_ms = self.draw_clock(fault),
            "a bit of a node's files flips" => self.flip(at),
            "node's state is restored" => self.restore_node(at),
            "node's state is copied" => self.copy_node(at, format!("copy-{}", self.nodes.len())),
            "node's state is copied under its name" => {
                self.copy_node(at, self.nodes[at].name.clone())
            }
            "hub is killed" => self.hub_crash(process),
            "hub's disk is full" => {
                self.hub.file.fill();
                self.time.after(lasts, Event::HubDiskFree);
            }
            HUB_CLOCK => self.hub.processes[process].clock_ms = self.draw_clock(fault),
            "hub is put back from a backup" => self.restore_hub(),
            "network is cut" => self.time.cut_until_ms = self.time.now_ms + lasts,
            _ => unreachable!("{fault}"),
        }
    }

    /// Draws how far the clock that a fault sets is ahead from now on, ms.
    fn draw_clock(&mut self, fault: &str) -> i64 {
        let near = [1, HOUR, 3 * DAY];
        let near_and_far = [1, HOUR, 3 * DAY, 40 * DAY, 400 * DAY, 60 * 365 * DAY];
        let most = if fault == self.far_clock {
            self.time.one_of(&near_and_far)
        } else {
            self.time.one_of(&near)
        };
        self.time.between(1 - most, most)
    }

    /// Flips a bit while the node is off. The damaged reports may be lost, and the node must count them.
    fn flip(&mut self, at: usize) {
        let mut kept = self.nodes[at].kept();
        let in_memory = self.nodes[at].crash();
        kept.extend(in_memory);
        let random = self.time.random();
        self.nodes[at].flip(random);
        self.is_rewound = true;
        self.flips += 1;
        self.node_on(at);
        self.damaged.extend(&kept);
        self.excuse(kept);
    }

    fn restore_node(&mut self, at: usize) {
        let node = &mut self.nodes[at];
        let Some(state) = node.kept_state.clone() else {
            return;
        };
        let mut lost = node.kept();
        let in_memory = node.crash();
        lost.extend(in_memory);
        put(&node.file(), &state);
        self.is_rewound = true;
        // What the node counted as lost since that state is counted no more.
        self.losses_are_rewound |= self.flips > 0;
        self.excuse(lost);
        self.node_on(at);
    }

    fn copy_node(&mut self, at: usize, name: String) {
        if self.nodes.len() < MOST_NODES
            && let Some(state) = self.nodes[at].state()
        {
            self.is_rewound = true;
            self.add_node(name, Some(&state));
            self.excuse(BTreeSet::new());
        }
    }

    fn restore_hub(&mut self) {
        let Some(backup) = self.hub.file.backup.clone() else {
            return;
        };
        for process in 0..2 {
            self.hub_crash(process);
        }
        let before = self.hub.stored();
        self.hub.file.free();
        self.hub.file.restore(&backup);
        let after = self.hub.stored();
        let lost = before.into_keys().filter(|one| !after.contains_key(one));
        self.forgotten.extend(lost);
        self.excuse(BTreeSet::new());
    }

    /// Excuses the `lost` and forgotten reports that exist nowhere: after a rewound state the counts do not reveal them.
    fn excuse(&mut self, mut lost: BTreeSet<usize>) {
        lost.extend(&self.forgotten);
        let stored = self.hub.stored();
        let mut kept = BTreeSet::new();
        for node in &self.nodes {
            kept.append(&mut node.kept());
            kept.extend(&node.in_memory);
        }
        for one in lost {
            let is_asked_for = !self.is_rewound || !self.forgotten.contains(&one);
            let is_safe = stored.contains_key(&one) || (kept.contains(&one) && is_asked_for);
            if !is_safe {
                self.excused.insert(one);
            }
        }
    }

    /// Ends all faults; each node makes one more report.
    fn heal(&mut self) {
        self.time.calm_down();
        self.hub.file.free();
        for process in 0..2 {
            if !self.hub.is_on(process) {
                self.time.after(0, Event::HubOn(process));
            }
        }
        for at in 0..self.nodes.len() {
            self.nodes[at].faults.free_disk();
            self.node_on(at);
            self.make(at);
        }
    }

    /// True if everything is delivered and nothing is in flight.
    fn is_settled(&self) -> bool {
        let travels = |event: &Event| {
            matches!(
                event,
                Event::Batch(..) | Event::Commit(_) | Event::Reply(..) | Event::Clip(_)
            )
        };
        self.nodes.iter().all(Node::is_settled) && !self.time.events().any(travels)
    }

    fn check(&mut self) {
        if self.flips > 0 {
            for node in &self.nodes {
                self.excused.extend(node.refused().intersection(&self.damaged));
            }
        }
        let stored = self.hub.stored();
        for number in 0..self.reports {
            let times = stored.get(&number).copied().unwrap_or(0);
            let is_right = times == 1 || (times == 0 && self.excused.contains(&number));
            holds(
                "each report is stored once, or its loss is known",
                is_right,
                || format!("report {number} is stored {times} times"),
            );
        }
        let last = stored.keys().last();
        holds(
            "nothing is stored that nobody made",
            last < Some(&self.reports),
            || format!("report {last:?}"),
        );
        self.hub.check();
        let counts = self.nodes.iter().filter_map(Node::counts);
        let told_by = |counts: OutboxCounts| counts.status.lost + counts.status.undeliverable;
        let told: u64 = counts.map(told_by).sum();
        // A report that a restored hub forgot was delivered: its node counts no loss. And a second flip may hit the count
        // of what the first one took; the log has told it then.
        let mut gone = 0;
        if self.flips == 1 && !self.losses_are_rewound {
            for report in &self.damaged {
                let is_gone = !stored.contains_key(report) && !self.forgotten.contains(report);
                gone += u64::from(is_gone);
            }
        }
        holds(
            "what a flipped bit takes is counted at the node",
            gone <= told,
            || format!("{gone} damaged, {told} told"),
        );
        self.time.note(&stored);
    }
}
