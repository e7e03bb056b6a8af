//! Plays the events of nodes and a hub in order of virtual time.

use super::hub::{Asker, Hub, Reply};
use super::node::{Node, put};
use super::timeline::{DAY, HOUR, Payload, Run, SECOND, Timeline, folder};
use std::collections::BTreeSet;
use std::rc::Rc;
use tempfile::TempDir;

/// Once nothing fails any more, everything is delivered within this time.
const SETTLED_WITHIN: i64 = 48 * HOUR;
const MOST_NODES: usize = 5;

/// Faults of a node, a hub or the network.
const FAULTS: [&str; 11] = [
    "node loses power",
    "node's disk is full",
    "node's clock is set",
    "node's state is restored",
    "node's state is copied",
    "node's state is copied under its name",
    "hub is killed",
    "hub's disk is full",
    "hub's clock is set",
    "hub is put back from a backup",
    "network is cut",
];

#[derive(Clone, Debug)]
enum Event {
    Clip(usize),
    Look(usize),
    Batch(Asker, Payload<Vec<u8>>),
    Commit(usize),
    Reply(Asker, Payload<Reply>),
    TimeOut(Asker),
    NodeOn(usize),
    HubOn(usize),
    NodeDiskFree(usize),
    HubDiskFree,
    KeepNode(usize),
    BackUp,
    Fault,
    End,
}

/// Whose clock may be off by months or years. With both off at once, nobody could tell what is old.
#[derive(Clone, Copy, PartialEq)]
enum Far {
    Nobody,
    Node,
    Hub,
}

pub(super) struct World {
    time: Timeline<Event>,
    end_ms: i64,
    folder: TempDir,
    nodes: Vec<Node>,
    hub: Hub,
    /// The node of each report.
    reports: Vec<usize>,
    /// Reports lost with whatever held them, or refused by the hub by name: stored at most once.
    excused: BTreeSet<usize>,
    far: Far,
    /// Reports that the hub lost when its backup was restored.
    forgotten: BTreeSet<usize>,
    /// True if a node's state was restored or copied, or its counts were not on the disk.
    is_rewound: bool,
}

impl World {
    pub(super) fn new(seed: u64, verbose: bool) -> Self {
        let folder = folder();
        let mut world = Self {
            time: Timeline::new(seed, verbose),
            end_ms: 0,
            nodes: Vec::new(),
            hub: Hub::new(folder.path(), seed + 1),
            folder,
            reports: Vec::new(),
            excused: BTreeSet::new(),
            far: Far::Nobody,
            forgotten: BTreeSet::new(),
            is_rewound: false,
        };
        world.end_ms = world.time.between(HOUR, 4 * HOUR);
        for _ in 0..world.time.below(3) + 1 {
            let name = format!("node-{}", world.nodes.len());
            world.add_node(name, None);
        }
        for process in 0..=usize::from(world.time.chance(300)) {
            world.time.after(0, Event::HubOn(process));
        }
        for _ in 0..world.time.below(12) {
            world.time.sometime(0, world.end_ms, Event::Fault);
        }
        for at in 0..world.nodes.len() {
            world.time.sometime(0, world.end_ms, Event::KeepNode(at));
        }
        world.far = [Far::Nobody, Far::Node, Far::Hub][world.time.below(3) as usize];
        // The hub asks for what it forgot within the week for which nodes keep it, by their own clocks.
        if world.far != Far::Node {
            world.time.sometime(0, world.end_ms, Event::BackUp);
        }
        world.time.after(world.end_ms, Event::End);
        world
    }

    pub(super) fn run(mut self) -> Result<Run, String> {
        while let Some(event) = self.time.next() {
            self.handle(event);
            if self.time.is_calm && self.is_settled() {
                return self.check();
            }
            if self.time.now_ms > self.end_ms + SETTLED_WITHIN {
                let counts: Vec<_> = self.nodes.iter().map(Node::counts).collect();
                return Err(format!("not settled: {counts:?}"));
            }
        }
        Err("no events are left".to_owned())
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
                    self.time
                        .sometime(60 * SECOND, 900 * SECOND, Event::Clip(at));
                }
            }
            Event::Look(at) => {
                if self.nodes[at].looks_at_ms <= self.time.now_ms {
                    self.nodes[at].looks_at_ms = i64::MAX;
                    self.look(at);
                }
            }
            Event::Batch(from, payload) => {
                let process = usize::from(self.hub.is_on(1) && self.time.chance(500));
                let now = self.time.now(self.hub.processes[process].clock_ms);
                let name = self.nodes[from.0].name.clone();
                if self.hub.take(process, &name, from, &payload.0, now) {
                    self.time.after(100, Event::Commit(process));
                }
            }
            Event::Commit(process) => self.commit(process),
            Event::Reply(to, reply) => {
                if self.nodes[to.0].awaits(to.1) {
                    if self.time.unlucky(10) {
                        return self.node_crash(to.0);
                    }
                    self.conclude(to.0, Some(&reply.0));
                    if self.time.unlucky(10) {
                        self.node_crash(to.0);
                    }
                }
            }
            Event::TimeOut(asker) => {
                if self.nodes[asker.0].awaits(asker.1) {
                    self.conclude(asker.0, None);
                }
            }
            Event::NodeOn(at) => self.node_on(at),
            Event::HubOn(process) => {
                let now = self.time.now(self.hub.processes[process].clock_ms);
                self.hub.switch_on(process, now);
            }
            Event::NodeDiskFree(at) => self.nodes[at].fill_disk(false),
            Event::HubDiskFree => self.hub.file.fill(false),
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
            let (now, random) = (self.time.now(self.nodes[at].clock_ms), self.time.random());
            self.nodes[at].switch_on(now, random);
            self.note_counts(at);
            self.look(at);
            self.time.sometime(SECOND, 600 * SECOND, Event::Clip(at));
        }
    }

    /// After a power cut, running counts that were not on the disk are missing or given again.
    fn note_counts(&mut self, at: usize) {
        if !self.nodes[at]
            .counts()
            .is_some_and(|counts| counts.status.durable)
        {
            self.is_rewound = true;
            self.excuse(BTreeSet::new());
        }
    }

    fn make(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            let (now, random) = (self.time.now(self.nodes[at].clock_ms), self.time.random());
            let number = self.reports.len();
            self.reports.push(at);
            self.time.note(&format!("node {at} makes report {number}"));
            self.nodes[at].make(number, random as u16, now);
            self.look(at);
        }
    }

    fn look(&mut self, at: usize) {
        let (question, now) = (self.time.number(), self.time.now(self.nodes[at].clock_ms));
        let (payload, pause) = self.nodes[at].look(question, now);
        if let Some(payload) = payload {
            self.time
                .send(&Event::Batch((at, question), Payload(Rc::new(payload))));
            self.time.after(10 * SECOND, Event::TimeOut((at, question)));
        }
        let pause = i64::try_from(pause.as_millis()).unwrap_or(HOUR).max(1);
        let node = &mut self.nodes[at];
        if node.is_on() && self.time.now_ms + pause < node.looks_at_ms {
            node.looks_at_ms = self.time.now_ms + pause;
            self.time.after(pause, Event::Look(at));
        }
    }

    fn conclude(&mut self, at: usize, reply: Option<&Reply>) {
        let now = self.time.now(self.nodes[at].clock_ms);
        let reply = reply.map(|reply| reply.as_deref().map_err(Vec::as_slice));
        if self.time.verbose {
            let (Ok(said) | Err(said)) = reply.unwrap_or(Err(b"no reply"));
            let counts = self.nodes[at].counts();
            println!("{} to {counts:?}", String::from_utf8_lossy(said));
        }
        self.excused.extend(self.nodes[at].take(reply, now));
        self.look(at);
    }

    fn commit(&mut self, process: usize) {
        if self.time.unlucky(15) {
            return self.hub_crash(process);
        }
        let now = self.time.now(self.hub.processes[process].clock_ms);
        let replies = self.hub.commit(process, now);
        if self.time.unlucky(15) {
            return self.hub_crash(process);
        }
        for (to, reply) in replies {
            self.time.send(&Event::Reply(to, Payload(Rc::new(reply))));
        }
    }

    fn node_crash(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            self.time.count(FAULTS[0]);
            self.time.note(&format!("power of node {at} goes"));
            self.note_counts(at);
            self.excused.extend(self.nodes[at].crash());
            self.time.sometime(SECOND, HOUR / 6, Event::NodeOn(at));
        }
    }

    fn hub_crash(&mut self, process: usize) {
        if self.hub.is_on(process) {
            self.time.count(FAULTS[6]);
            self.time.note(&format!("hub {process} is killed"));
            self.hub.crash(process);
            self.time.sometime(SECOND, HOUR / 6, Event::HubOn(process));
        }
    }

    fn fault(&mut self) {
        let at = self.time.below(self.nodes.len() as u64) as usize;
        let process = usize::from(self.hub.is_on(1) && self.time.chance(500));
        let kind = self.time.below(FAULTS.len() as u64) as usize;
        let lasts = self.time.between(SECOND, HOUR / 2);
        self.time.note(&format!("{} (node {at})", FAULTS[kind]));
        match kind {
            0 => return self.node_crash(at),
            1 => {
                self.nodes[at].fill_disk(true);
                self.time.after(lasts, Event::NodeDiskFree(at));
            }
            2 => self.nodes[at].clock_ms = self.clock(self.far == Far::Node),
            3 => self.restore_node(at),
            4 | 5 => self.copy_node(at, kind == 5),
            6 => return self.hub_crash(process),
            7 => {
                self.hub.file.fill(true);
                self.time.after(lasts, Event::HubDiskFree);
            }
            8 => self.hub.processes[process].clock_ms = self.clock(self.far == Far::Hub),
            9 => self.restore_hub(),
            _ => self.time.cut_until_ms = self.time.now_ms + lasts,
        }
        self.time.count(FAULTS[kind]);
    }

    /// Draws how far a clock is ahead from now on, ms.
    fn clock(&mut self, far: bool) -> i64 {
        let days = match self.time.below(if far { 5 } else { 3 }) {
            0 => return 0,
            1 => return self.time.between(-HOUR, HOUR),
            2 => 3,
            3 => 40,
            _ => 4000,
        };
        self.time.between(-days * DAY, days * DAY)
    }

    /// Restores an earlier state of a node.
    fn restore_node(&mut self, at: usize) {
        let Some(state) = self.nodes[at].kept_state.clone() else {
            return;
        };
        let mut lost: BTreeSet<usize> = self.nodes[at].crash().into_iter().collect();
        lost.append(&mut self.nodes[at].kept());
        put(&self.nodes[at].file(), &state);
        self.is_rewound = true;
        self.excuse(lost);
        self.node_on(at);
    }

    /// Starts another node with a copy of a node's state.
    fn copy_node(&mut self, at: usize, under_its_name: bool) {
        if let Some(state) = self.nodes[at]
            .state()
            .filter(|_| self.nodes.len() < MOST_NODES)
        {
            let name = if under_its_name {
                self.nodes[at].name.clone()
            } else {
                format!("copy-{}", self.nodes.len())
            };
            self.is_rewound = true;
            self.add_node(name, Some(&state));
            self.excuse(BTreeSet::new());
        }
    }

    fn restore_hub(&mut self) {
        let Some(backup) = self.hub.file.backup() else {
            return;
        };
        for process in 0..2 {
            self.hub_crash(process);
        }
        let before = self.hub.stored();
        self.hub.file.fill(false);
        self.hub.file.restore(&backup, &[]);
        let after = self.hub.stored();
        let lost = before.into_keys().filter(|one| !after.contains_key(one));
        self.forgotten.extend(lost);
        self.excuse(BTreeSet::new());
    }

    /// Excuses those of the `lost` and forgotten reports that no longer exist anywhere. If a node's state was rewound too, the
    /// running counts do not reveal what the hub forgot.
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
        (self.time.is_calm, self.time.cut_until_ms) = (true, 0);
        self.hub.file.fill(false);
        for process in 0..2 {
            if !self.hub.is_on(process) {
                self.time.after(0, Event::HubOn(process));
            }
        }
        for at in 0..self.nodes.len() {
            self.nodes[at].fill_disk(false);
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

    fn check(mut self) -> Result<Run, String> {
        let stored = self.hub.stored();
        let mut wrong = Vec::new();
        for (number, node) in self.reports.iter().enumerate() {
            let times = stored.get(&number).copied().unwrap_or(0);
            if times > 1 || (times == 0 && !self.excused.contains(&number)) {
                wrong.push(format!(
                    "report {number} of node {node} is stored {times} times"
                ));
            }
        }
        if stored.keys().any(|number| *number >= self.reports.len()) {
            wrong.push("a report that nobody made is stored".to_owned());
        }
        wrong.extend(self.hub.check().err());
        if (self.nodes.iter().filter_map(Node::counts)).any(|counts| counts.status.lost > 0) {
            wrong.push("a report was lost because the outbox was full".to_owned());
        }
        if !wrong.is_empty() {
            return Err(wrong.join("; "));
        }
        self.time.note(&stored);
        Ok(self.time.run(self.reports.len()))
    }
}
