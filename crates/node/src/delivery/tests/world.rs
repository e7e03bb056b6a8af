//! What happens, in the order of virtual time.

use super::hub::{Asker, Hub, Reply};
use super::node::{Node, put};
use albireo_service::clock::Now;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

const SECOND: i64 = 1000;
const HOUR: i64 = 3600 * SECOND;
const DAY: i64 = 24 * HOUR;
/// The wall clock at the beginning: November 2026.
const BEGIN: i64 = 1_795_000_000_000;
/// By then everything is delivered once nothing fails any more.
const SETTLED_WITHIN: i64 = 48 * HOUR;
const MOST_NODES: usize = 5;

/// What fails, or is done to a node or a hub.
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

/// Bytes that travel.
#[derive(Clone)]
struct Payload<T>(Rc<T>);

impl<T: Hash> std::fmt::Debug for Payload<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut hasher = DefaultHasher::new();
        self.0.hash(&mut hasher);
        write!(f, "{:016x}", hasher.finish())
    }
}

/// Whose clock may be off by months or years; of both at once nobody can tell what is old.
#[derive(Clone, Copy, PartialEq)]
enum Far {
    Nobody,
    Node,
    Hub,
}

/// What came of a run.
pub(super) struct Run {
    pub(super) node_hours: f64,
    pub(super) reports: u64,
    pub(super) faults: BTreeMap<&'static str, u64>,
    /// A hash of everything that happened, in order.
    pub(super) trace: u64,
}

pub(super) struct World {
    random: Pcg64Mcg,
    began: Instant,
    now_ms: i64,
    end_ms: i64,
    made: u64,
    events: BTreeMap<(i64, u64), Event>,
    folder: tempfile::TempDir,
    nodes: Vec<Node>,
    hub: Hub,
    /// The node of each report.
    reports: Vec<usize>,
    /// Reports that were lost with what held them, or that the hub refused by name: stored once at most.
    excused: BTreeSet<usize>,
    /// Older states of nodes.
    states: BTreeMap<usize, Vec<u8>>,
    backup: Option<Vec<u8>>,
    far: Far,
    /// Reports that the hub lost when it was put back.
    forgotten: BTreeSet<usize>,
    /// Whether the state of a node went back or was copied, or its counts were not on its disk.
    is_rewound: bool,
    /// Whether anything may still fail.
    is_calm: bool,
    cut_until_ms: i64,
    node_ms: i64,
    faults: BTreeMap<&'static str, u64>,
    trace: DefaultHasher,
    verbose: bool,
}

impl World {
    pub(super) fn new(seed: u64, verbose: bool) -> Self {
        let memory = std::path::Path::new("/dev/shm");
        let folder = if memory.is_dir() {
            tempfile::tempdir_in(memory)
        } else {
            tempfile::tempdir()
        };
        let folder = folder.unwrap();
        let mut world = Self {
            random: Pcg64Mcg::seed_from_u64(seed),
            began: Instant::now(),
            now_ms: 0,
            end_ms: 0,
            made: 0,
            events: BTreeMap::new(),
            nodes: Vec::new(),
            hub: Hub::new(folder.path(), seed + 1),
            folder,
            reports: Vec::new(),
            excused: BTreeSet::new(),
            states: BTreeMap::new(),
            backup: None,
            far: Far::Nobody,
            forgotten: BTreeSet::new(),
            is_rewound: false,
            is_calm: false,
            cut_until_ms: 0,
            node_ms: 0,
            faults: BTreeMap::new(),
            trace: DefaultHasher::new(),
            verbose,
        };
        world.end_ms = world.between(HOUR, 4 * HOUR);
        for _ in 0..world.below(3) + 1 {
            let name = format!("node-{}", world.nodes.len());
            world.add_node(name, None);
        }
        for process in 0..=usize::from(world.chance(300)) {
            world.after(0, Event::HubOn(process));
        }
        for _ in 0..world.below(12) {
            let at = world.between(0, world.end_ms);
            world.after(at, Event::Fault);
        }
        for at in 0..world.nodes.len() {
            let when = world.between(0, world.end_ms);
            world.after(when, Event::KeepNode(at));
        }
        world.far = [Far::Nobody, Far::Node, Far::Hub][world.below(3) as usize];
        // What a hub forgot is asked for within the week that nodes keep it, by their own clocks.
        if world.far != Far::Node {
            let when = world.between(0, world.end_ms);
            world.after(when, Event::BackUp);
        }
        world.after(world.end_ms, Event::End);
        world
    }

    fn below(&mut self, most: u64) -> u64 {
        self.random.next_u64() % most
    }

    fn between(&mut self, from: i64, to: i64) -> i64 {
        from + self.below((to - from).unsigned_abs()).cast_signed()
    }

    fn chance(&mut self, of_thousand: u64) -> bool {
        self.below(1000) < of_thousand
    }

    /// Whether something rare goes wrong just now.
    fn unlucky(&mut self, of_thousand: u64) -> bool {
        !self.is_calm && self.chance(of_thousand)
    }

    fn after(&mut self, ms: i64, event: Event) {
        self.made += 1;
        self.events.insert((self.now_ms + ms, self.made), event);
    }

    fn now(&self, clock_ms: i64) -> Now {
        Now {
            at: self.began + Duration::from_millis(self.now_ms.unsigned_abs()),
            unix_ms: BEGIN + self.now_ms + clock_ms,
        }
    }

    fn note(&mut self, what: &impl std::fmt::Debug) {
        let line = format!("{:>9} {what:?}", self.now_ms);
        line.hash(&mut self.trace);
        if self.verbose {
            println!("{}", line.chars().take(200).collect::<String>());
        }
    }

    /// Sends over the network, which may lose it, double it or take its time.
    fn send(&mut self, event: &Event) {
        if self.now_ms < self.cut_until_ms || self.unlucky(60) {
            return;
        }
        for _ in 0..=u8::from(self.unlucky(60)) {
            let most = if self.unlucky(60) { HOUR } else { 2 * SECOND };
            let takes = self.between(10, most);
            self.after(takes, event.clone());
        }
    }

    pub(super) fn run(mut self) -> Result<Run, String> {
        while let Some(((at_ms, _), event)) = self.events.pop_first() {
            let on = self.nodes.iter().filter(|node| node.is_on()).count();
            self.node_ms += (at_ms - self.now_ms) * on as i64;
            self.now_ms = at_ms;
            self.note(&event);
            self.happen(event);
            if self.is_calm && self.is_settled() {
                return self.check();
            }
            if self.now_ms > self.end_ms + SETTLED_WITHIN {
                let counts: Vec<_> = self.nodes.iter().map(Node::counts).collect();
                return Err(format!("it does not settle: {counts:?}"));
            }
        }
        Err("nothing happens any more".to_owned())
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Clip(at) => {
                if self.unlucky(5) {
                    return self.node_crash(at);
                }
                self.make(at);
                if self.unlucky(5) {
                    return self.node_crash(at);
                }
                if !self.is_calm {
                    let pause = self.between(60 * SECOND, 900 * SECOND);
                    self.after(pause, Event::Clip(at));
                }
            }
            Event::Look(at) => {
                if self.nodes[at].looks_at_ms <= self.now_ms {
                    self.nodes[at].looks_at_ms = i64::MAX;
                    self.look(at);
                }
            }
            Event::Batch(from, payload) => {
                let process = usize::from(self.hub.is_on(1) && self.chance(500));
                let now = self.now(self.hub.processes[process].clock_ms);
                let name = self.nodes[from.0].name.clone();
                if self.hub.take(process, &name, from, &payload.0, now) {
                    self.after(100, Event::Commit(process));
                }
            }
            Event::Commit(process) => self.commit(process),
            Event::Reply(to, reply) => {
                if self.nodes[to.0].awaits(to.1) {
                    if self.unlucky(10) {
                        return self.node_crash(to.0);
                    }
                    self.conclude(to.0, Some(&reply.0));
                    if self.unlucky(10) {
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
                let now = self.now(self.hub.processes[process].clock_ms);
                self.hub.switch_on(process, now);
            }
            Event::NodeDiskFree(at) => {
                self.nodes[at]
                    .faults
                    .is_full
                    .store(false, Ordering::Relaxed);
            }
            Event::HubDiskFree => self.hub.fill(false),
            Event::KeepNode(at) => {
                if let Some(state) = self.nodes[at].state() {
                    self.states.insert(at, state);
                }
            }
            Event::BackUp => self.backup = self.hub.backup().or_else(|| self.backup.take()),
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
            let (now, random) = (self.now(self.nodes[at].clock_ms), self.random.next_u64());
            self.nodes[at].switch_on(now, random);
            self.note_counts(at);
            self.look(at);
            let pause = self.between(SECOND, 600 * SECOND);
            self.after(pause, Event::Clip(at));
        }
    }

    /// Running counts that are not on the disk are missing, or given once more after the power went.
    fn note_counts(&mut self, at: usize) {
        if !self.nodes[at].counts().is_some_and(|counts| counts.durable) {
            self.is_rewound = true;
            self.excuse(BTreeSet::new());
        }
    }

    fn make(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            let (now, random) = (self.now(self.nodes[at].clock_ms), self.random.next_u64());
            let number = self.reports.len();
            self.reports.push(at);
            self.note(&format!("node {at} makes report {number}"));
            self.nodes[at].make(number, random as u16, now);
            self.look(at);
        }
    }

    fn look(&mut self, at: usize) {
        self.made += 1;
        let (question, now) = (self.made, self.now(self.nodes[at].clock_ms));
        let (payload, pause) = self.nodes[at].look(question, now);
        if let Some(payload) = payload {
            self.send(&Event::Batch((at, question), Payload(Rc::new(payload))));
            self.after(10 * SECOND, Event::TimeOut((at, question)));
        }
        let pause = i64::try_from(pause.as_millis()).unwrap_or(HOUR).max(1);
        let node = &mut self.nodes[at];
        if node.is_on() && self.now_ms + pause < node.looks_at_ms {
            node.looks_at_ms = self.now_ms + pause;
            self.after(pause, Event::Look(at));
        }
    }

    fn conclude(&mut self, at: usize, reply: Option<&Reply>) {
        let now = self.now(self.nodes[at].clock_ms);
        let reply = reply.map(|reply| reply.as_deref().map_err(Vec::as_slice));
        if self.verbose {
            let (Ok(said) | Err(said)) = reply.unwrap_or(Err(b"no reply"));
            let counts = self.nodes[at].counts();
            println!("{} to {counts:?}", String::from_utf8_lossy(said));
        }
        self.excused.extend(self.nodes[at].take(reply, now));
        self.look(at);
    }

    fn commit(&mut self, process: usize) {
        if self.unlucky(15) {
            return self.hub_crash(process);
        }
        let now = self.now(self.hub.processes[process].clock_ms);
        let replies = self.hub.commit(process, now);
        if self.unlucky(15) {
            return self.hub_crash(process);
        }
        for (to, reply) in replies {
            self.send(&Event::Reply(to, Payload(Rc::new(reply))));
        }
    }

    fn node_crash(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            *self.faults.entry(FAULTS[0]).or_default() += 1;
            self.note(&format!("power of node {at} goes"));
            self.note_counts(at);
            self.excused.extend(self.nodes[at].crash());
            let pause = self.between(SECOND, HOUR / 6);
            self.after(pause, Event::NodeOn(at));
        }
    }

    fn hub_crash(&mut self, process: usize) {
        if self.hub.is_on(process) {
            *self.faults.entry(FAULTS[6]).or_default() += 1;
            self.note(&format!("hub {process} is killed"));
            self.hub.crash(process);
            let pause = self.between(SECOND, HOUR / 6);
            self.after(pause, Event::HubOn(process));
        }
    }

    fn fault(&mut self) {
        let at = self.below(self.nodes.len() as u64) as usize;
        let process = usize::from(self.hub.is_on(1) && self.chance(500));
        let kind = self.below(FAULTS.len() as u64) as usize;
        let lasts = self.between(SECOND, HOUR / 2);
        self.note(&format!("{} (node {at})", FAULTS[kind]));
        match kind {
            0 => return self.node_crash(at),
            1 => {
                self.nodes[at].faults.is_full.store(true, Ordering::Relaxed);
                self.after(lasts, Event::NodeDiskFree(at));
            }
            2 => self.nodes[at].clock_ms = self.clock(self.far == Far::Node),
            3 => self.restore_node(at),
            4 | 5 => self.copy_node(at, kind == 5),
            6 => return self.hub_crash(process),
            7 => {
                self.hub.fill(true);
                self.after(lasts, Event::HubDiskFree);
            }
            8 => self.hub.processes[process].clock_ms = self.clock(self.far == Far::Hub),
            9 => self.restore_hub(),
            _ => self.cut_until_ms = self.now_ms + lasts,
        }
        *self.faults.entry(FAULTS[kind]).or_default() += 1;
    }

    /// How far a clock is ahead from now on.
    fn clock(&mut self, far: bool) -> i64 {
        let days = match self.below(if far { 5 } else { 3 }) {
            0 => return 0,
            1 => return self.between(-HOUR, HOUR),
            2 => 3,
            3 => 40,
            _ => 4000,
        };
        self.between(-days * DAY, days * DAY)
    }

    /// An older copy of its state takes the place of what a node has.
    fn restore_node(&mut self, at: usize) {
        let Some(state) = self.states.get(&at) else {
            return;
        };
        let mut lost: BTreeSet<usize> = self.nodes[at].crash().into_iter().collect();
        lost.append(&mut self.nodes[at].kept());
        put(&self.nodes[at].file(), state);
        self.is_rewound = true;
        self.excuse(lost);
        self.node_on(at);
    }

    /// Another node begins with a copy of a node's state.
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
        let Some(backup) = self.backup.clone() else {
            return;
        };
        for process in 0..2 {
            self.hub_crash(process);
        }
        let before = self.hub.stored();
        self.hub.restore(&backup);
        let after = self.hub.stored();
        let lost = before.into_keys().filter(|one| !after.contains_key(one));
        self.forgotten.extend(lost);
        self.excuse(BTreeSet::new());
    }

    /// Excuses those of the lost reports that nobody has any more, and of those that the hub forgot. Where the state of a node
    /// was rewound too, the running counts do not tell what the hub forgot.
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

    /// Nothing fails any more, and each node makes one report.
    fn heal(&mut self) {
        (self.is_calm, self.cut_until_ms) = (true, 0);
        self.hub.fill(false);
        for process in 0..2 {
            if !self.hub.is_on(process) {
                self.after(0, Event::HubOn(process));
            }
        }
        for at in 0..self.nodes.len() {
            self.nodes[at]
                .faults
                .is_full
                .store(false, Ordering::Relaxed);
            self.node_on(at);
            self.make(at);
        }
    }

    /// Whether everything is delivered, and nothing under way.
    fn is_settled(&self) -> bool {
        let travels = |event: &Event| {
            matches!(
                event,
                Event::Batch(..) | Event::Commit(_) | Event::Reply(..) | Event::Clip(_)
            )
        };
        self.nodes.iter().all(Node::is_settled) && !self.events.values().any(travels)
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
            wrong.push("a report is stored that nobody made".to_owned());
        }
        wrong.extend(self.hub.check().err());
        if (self.nodes.iter().filter_map(Node::counts)).any(|counts| counts.lost > 0) {
            wrong.push("a report was lost for want of room".to_owned());
        }
        if !wrong.is_empty() {
            return Err(wrong.join("; "));
        }
        self.note(&stored);
        Ok(Run {
            node_hours: self.node_ms as f64 / HOUR as f64,
            reports: self.reports.len() as u64,
            faults: self.faults,
            trace: self.trace.finish(),
        })
    }
}
