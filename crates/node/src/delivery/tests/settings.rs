//! Simulates settings sent from a hub to nodes: real orders and rollouts on a real database, and the real files of nodes,
//! connected by a network that loses, delays, duplicates and reorders messages.

mod hub;
mod node;

use super::timeline::{HOUR, Payload, Run, SECOND, Timeline, folder};
use albireo_hub::tuning::run::Command;
use albireo_wire::DesiredSetting;
use hub::Hub;
use node::Node;
use std::collections::BTreeMap;
use std::rc::Rc;
use tempfile::TempDir;

/// Once nothing fails any more, every order is answered and every rollout has ended within this time.
const SETTLED_WITHIN: i64 = 4 * HOUR;
const TICK: i64 = 5 * SECOND;

/// Faults of a node, a hub or the network.
const FAULTS: [&str; 9] = [
    "node loses power",
    "node's state is restored",
    "node is far away",
    "hub is killed",
    "hub is killed at a commit",
    "hub's disk is full",
    "hub is put back from a backup",
    "network is cut",
    "somebody changes a threshold at a node",
];

const COMMANDS: [Command; 5] = [
    Command::Pause,
    Command::Resume,
    Command::Next,
    Command::Return,
    Command::Stop,
];

#[derive(Clone, Debug)]
enum Event {
    /// A node checks what it has to send.
    Look(usize),
    Status(usize, Payload<Vec<u8>>),
    Notice(usize),
    Pull(usize, u64),
    Pulled(usize, u64, Payload<Vec<u8>>),
    TimeOut(usize, u64),
    NodeOn(usize),
    HubOn,
    HubDiskFree,
    /// The hub processes what nodes reported.
    Tick,
    Order,
    Rollout,
    Command,
    KeepNode(usize),
    BackUp,
    Fault,
    End,
}

pub(super) struct Settings {
    time: Timeline<Event>,
    end_ms: i64,
    nodes: Vec<Node>,
    hub: Hub,
    /// Number of values ordered so far.
    values: u64,
    /// What each node accepted, by revision.
    taken: BTreeMap<(usize, u64), DesiredSetting>,
    /// When the hub was last restored.
    restored_ms: i64,
    _folder: TempDir,
}

impl Settings {
    pub(super) fn new(seed: u64, verbose: bool) -> Self {
        let folder = folder();
        let mut time = Timeline::new(seed, verbose);
        let end_ms = time.between(HOUR / 4, HOUR);
        let nodes = (0..2 + time.below(3) as usize)
            .map(|at| Node::new(format!("node-{at}"), folder.path()));
        let mut world = Self {
            end_ms,
            nodes: nodes.collect(),
            hub: Hub::new(folder.path()),
            values: 0,
            taken: BTreeMap::new(),
            restored_ms: -1,
            _folder: folder,
            time,
        };
        world.time.after(0, Event::HubOn);
        world.time.after(TICK, Event::Tick);
        for at in 0..world.nodes.len() {
            world.time.after(0, Event::NodeOn(at));
        }
        let plenty = [
            (6, Event::Order),
            (4, Event::Rollout),
            (5, Event::Command),
            (10, Event::Fault),
            (2, Event::BackUp),
        ];
        for (most, event) in plenty {
            for _ in 0..=world.time.below(most) {
                world.time.sometime(10 * SECOND, end_ms, event.clone());
            }
        }
        for at in 0..world.nodes.len() {
            world.time.sometime(0, end_ms, Event::KeepNode(at));
        }
        world.time.after(end_ms, Event::End);
        world
    }

    /// Runs to the end; returns an error if the final state is wrong.
    pub(super) fn run(mut self) -> Result<Run, String> {
        while let Some(event) = self.time.next() {
            let is_tick = matches!(event, Event::Tick);
            self.handle(event)?;
            if !self.time.is_calm || !is_tick {
                continue;
            }
            let wrong = self.wrong();
            if wrong.is_empty() {
                return Ok(self.time.run(self.values as usize));
            }
            if self.time.now_ms > self.end_ms + SETTLED_WITHIN {
                return Err(wrong.join("; "));
            }
        }
        Err("no events are left".to_owned())
    }

    fn handle(&mut self, event: Event) -> Result<(), String> {
        match event {
            Event::Look(at) => self.look(at),
            Event::Status(at, payload) => {
                let now = self.time.now(0);
                if self.hub.hear(&self.nodes[at].name, &payload.0, now) {
                    self.time.send(&Event::Notice(at));
                }
            }
            Event::Notice(at) => self.nodes[at].notice(),
            Event::Pull(at, question) => {
                if let Some(answer) = self.hub.answer(&self.nodes[at].name) {
                    let answer = Payload(Rc::new(answer));
                    self.time.send(&Event::Pulled(at, question, answer));
                }
            }
            Event::Pulled(at, question, answer) => return self.pulled(at, question, &answer.0),
            Event::TimeOut(at, question) => {
                let now = self.time.now(0);
                self.nodes[at].conclude(question, None, now);
            }
            Event::NodeOn(at) => self.node_on(at),
            Event::HubOn => {
                if !self.hub.switch_on(self.time.now(0)) {
                    self.time.after(5 * SECOND, Event::HubOn);
                }
            }
            Event::HubDiskFree => self.hub.file.fill(false),
            Event::Tick => {
                self.hub.tick(self.time.now(0));
                self.notices();
                self.time.after(TICK, Event::Tick);
            }
            Event::Order => self.order(),
            Event::Rollout => self.rollout(),
            Event::Command => {
                let command = COMMANDS[self.time.below(5) as usize];
                let which = self.time.random();
                let now = self.time.now(0);
                self.hub.command(which, command, now);
                self.notices();
            }
            Event::KeepNode(at) => self.nodes[at].keep_state(),
            Event::BackUp => self.hub.file.back_up(),
            Event::Fault => self.fault(),
            Event::End => self.heal(),
        }
        Ok(())
    }

    fn node_on(&mut self, at: usize) {
        if !self.nodes[at].is_on() {
            let (now, random) = (self.time.now(0), self.time.random());
            self.nodes[at].switch_on(now, random);
            self.time.after(0, Event::Look(at));
        }
    }

    fn look(&mut self, at: usize) {
        if !self.nodes[at].is_on() {
            return;
        }
        let (now, question) = (self.time.now(0), self.time.number());
        let (status, pulls) = self.nodes[at].look(question, now);
        if let Some(status) = status {
            self.time.send(&Event::Status(at, Payload(Rc::new(status))));
        }
        if pulls {
            self.time.send(&Event::Pull(at, question));
            self.time.after(10 * SECOND, Event::TimeOut(at, question));
        }
        self.time.sometime(SECOND, 5 * SECOND, Event::Look(at));
    }

    fn pulled(&mut self, at: usize, question: u64, answer: &[u8]) -> Result<(), String> {
        let (now, before) = (self.time.now(0), self.nodes[at].state());
        let Some(taken) = self.nodes[at].conclude(question, Some(answer), now) else {
            return Ok(());
        };
        self.time.note(&taken);
        let (revision, setting) = taken;
        let known = *self.taken.entry((at, revision)).or_insert(setting);
        if known != setting {
            return Err(format!(
                "node {at} got revision {revision} twice: {known} and {setting}"
            ));
        }
        if self.time.unlucky(30) {
            // The thresholds reach the disk before what is known of the hub, or neither does.
            let after = self.nodes[at].state();
            self.node_crash(at);
            match self.time.below(3) {
                0 => self.nodes[at].put_state(before),
                1 => self.nodes[at].put_state(node::between(before, after)),
                _ => {}
            }
        }
        Ok(())
    }

    fn notices(&mut self) {
        for node in self.hub.notices() {
            let at = self.nodes.iter().position(|one| one.name == node);
            if let Some(at) = at {
                self.time.send(&Event::Notice(at));
            }
        }
    }

    /// A value not ordered before; some are out of range.
    fn value(&mut self) -> f64 {
        self.values += 1;
        if self.time.chance(100) {
            return 2.0 + self.values as f64;
        }
        1e-3 + self.values as f64 * 1e-4
    }

    /// Names of some of the nodes.
    fn some(&mut self) -> Vec<String> {
        let Self { nodes, time, .. } = self;
        let some = nodes.iter().filter(|_| time.chance(700));
        let mut names: Vec<_> = some.map(|node| node.name.clone()).collect();
        if names.is_empty() {
            names.push(nodes[0].name.clone());
        }
        names
    }

    fn order(&mut self) {
        let (names, value) = (self.some(), self.value());
        self.time.note(&format!("{value} for {names:?}"));
        self.hub.order(&names, value, self.time.now(0));
        self.notices();
    }

    fn rollout(&mut self) {
        let (names, value, seed) = (self.some(), self.value(), self.time.random());
        let seconds = [(); 4].map(|()| self.time.between(10, 300) as f64);
        let (holds, passes) = (self.time.chance(300), self.time.chance(500));
        self.time
            .note(&format!("rollout of {value} for {names:?}, {seconds:?}"));
        let now = self.time.now(0);
        self.hub
            .rollout(&names, value, seed, seconds, [holds, passes], now);
        self.notices();
    }

    fn node_crash(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            self.nodes[at].crash();
            self.time.sometime(SECOND, HOUR / 6, Event::NodeOn(at));
        }
    }

    /// Kills the hub, which returns after at least `least_ms`.
    fn hub_crash(&mut self, least_ms: i64) {
        if self.hub.is_on() {
            self.hub.crash();
            self.time.sometime(least_ms, HOUR / 6, Event::HubOn);
        }
    }

    fn fault(&mut self) {
        let at = self.time.below(self.nodes.len() as u64) as usize;
        let kind = self.time.below(FAULTS.len() as u64) as usize;
        let lasts = self.time.between(SECOND, HOUR / 6);
        self.time.note(&format!("{} (node {at})", FAULTS[kind]));
        match kind {
            0 => self.node_crash(at),
            1 => {
                if let Some(state) = self.nodes[at].kept_state.clone() {
                    self.node_crash(at);
                    self.nodes[at].put_state(Some(state));
                    self.taken.retain(|(node, _), _| *node != at);
                }
            }
            2 => {
                // The node returns after the longest deadline of a rollout.
                if self.nodes[at].is_on() {
                    self.nodes[at].crash();
                    self.time.after(HOUR / 2, Event::NodeOn(at));
                }
            }
            3 => self.hub_crash(SECOND),
            4 => {
                let (cut, event) = (self.time.random(), self.time.below(3));
                let (names, value) = (self.some(), self.value());
                let command = COMMANDS[self.time.below(5) as usize];
                let now = self.time.now(0);
                let before = self.hub.commits();
                match event {
                    0 => self.hub.order(&names, value, now),
                    1 => self.hub.command(cut, command, now),
                    _ => self.hub.tick(now),
                }
                let image = self.hub.image_at_a_commit(before, cut);
                self.hub_crash(SECOND);
                self.hub.put(image);
            }
            5 => {
                self.hub.file.fill(true);
                self.time.after(lasts, Event::HubDiskFree);
            }
            6 => {
                if let Some(backup) = self.hub.file.backup()
                    && self.hub.is_on()
                {
                    // No backup is restored within the few seconds by which revisions may be ahead of the clock.
                    self.hub_crash(60 * SECOND);
                    self.hub.file.fill(false);
                    self.hub.put(Some((backup, Vec::new())));
                    self.restored_ms = self.time.now_ms;
                }
            }
            7 => self.time.cut_until_ms = self.time.now_ms + lasts,
            _ => {
                let value = self.value();
                self.nodes[at].set_by_hand(value);
            }
        }
        self.time.count(FAULTS[kind]);
    }

    /// Ends all faults and switches everything on.
    fn heal(&mut self) {
        (self.time.is_calm, self.time.cut_until_ms) = (true, 0);
        self.hub.file.fill(false);
        let now = self.time.now(0);
        assert!(self.hub.switch_on(now));
        self.hub.tick(now);
        for at in 0..self.nodes.len() {
            self.node_on(at);
        }
        for which in 0..self.hub.rollouts() {
            self.hub.command(which, Command::Resume, now);
        }
    }

    /// Everything that is wrong, or not done yet.
    fn wrong(&self) -> Vec<String> {
        let mut wrong = self.hub.unfinished();
        for (at, node) in self.nodes.iter().enumerate() {
            let Some(desired) = self.hub.desired(&node.name) else {
                continue;
            };
            let is_forgotten = desired.at_ms <= self.restored_ms;
            let has = node.has();
            // A value that the hub forgot with its database may be in force; one ordered since must not be skipped.
            if has.revision > desired.revision && is_forgotten {
                continue;
            }
            let is_taken = has.revision == desired.revision && (has.refused || has.by_hand);
            let is_taken = is_taken || has.settings == [desired.value; 2];
            if !is_taken {
                wrong.push(format!("node {at} has {has:?}, but {desired:?} is desired"));
            }
        }
        wrong
    }
}
