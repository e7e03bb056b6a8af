//! Simulates a node that keeps its desired settings in a real file.

use super::super::node::until_unlocked;
use crate::PreparedNode;
use crate::delivery::uplink::{Failure, Schedule, StatusSender, known, read_reply, take};
use crate::outbox::OutboxConfig;
use crate::settings::tests::{config, thresholds};
use albireo_service::clock::Now;
use albireo_wire::{Desired, DesiredSetting, SettingSource};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

struct Started {
    parts: PreparedNode,
    statuses: StatusSender,
    schedule: Schedule,
    asked: Option<u64>,
}

/// What a node sends next.
pub(super) struct NextStep {
    /// The status, if it is due.
    pub(super) status: Option<Vec<u8>>,
    /// True if it asks for the desired setting.
    pub(super) pulls: bool,
}

/// A setting that a node accepted.
#[derive(Debug)]
pub(super) struct Taken {
    pub(super) revision: u64,
    pub(super) setting: DesiredSetting,
}

pub(super) struct Node {
    pub(super) name: String,
    folder: PathBuf,
    started: Option<Started>,
    pub(super) kept_state: Option<Vec<u8>>,
}

impl Node {
    pub(super) fn new(name: String, folder: &Path) -> Self {
        let folder = folder.join(&name);
        std::fs::create_dir(&folder).unwrap();
        Self {
            name,
            folder,
            started: None,
            kept_state: None,
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.started.is_some()
    }

    pub(super) fn switch_on(&mut self, now: Now, random: u64) {
        let config = config(Some(&self.folder), "albireo");
        let parts = until_unlocked(|| PreparedNode::new(&config));
        let mut schedule = Schedule::new(&OutboxConfig::default(), random, now.at);
        schedule.begin(now.at);
        self.started = Some(Started {
            parts,
            statuses: StatusSender::new(BTreeMap::new(), random as u32, now),
            schedule,
            asked: None,
        });
    }

    pub(super) fn crash(&mut self) {
        self.started = None;
    }

    fn file(&self) -> PathBuf {
        self.folder.join("settings.json")
    }

    pub(super) fn state(&self) -> Option<Vec<u8>> {
        std::fs::read(self.file()).ok()
    }

    pub(super) fn keep_state(&mut self) {
        self.kept_state = self.state().or(self.kept_state.take());
    }

    /// Replaces or removes the settings file while the node is off.
    pub(super) fn put_state(&mut self, state: Option<Vec<u8>>) {
        match state {
            Some(state) => std::fs::write(self.file(), state).unwrap(),
            None => drop(std::fs::remove_file(self.file())),
        }
    }

    /// What the node sends next; `None` while it is off. `question` is the number of its request for the setting.
    pub(super) fn poll(&mut self, question: u64, now: Now) -> Option<NextStep> {
        let node = self.started.as_mut()?;
        let PreparedNode {
            board,
            settings,
            outbox,
            ..
        } = &node.parts;
        let status = node.statuses.due(now, board, settings, outbox);
        let pulls = node.schedule.next_pull(now.at);
        if pulls {
            node.asked = Some(question);
        }
        Some(NextStep { status, pulls })
    }

    pub(super) fn notice(&mut self) {
        if let Some(node) = &mut self.started {
            node.schedule.want_pull();
        }
    }

    /// Receives the answer to a request, or `None` after the timeout; returns the setting if it is accepted.
    pub(super) fn conclude(
        &mut self,
        question: u64,
        answer: Option<&[u8]>,
        now: Now,
    ) -> Option<Taken> {
        let node = self.started.as_mut()?;
        node.asked.take_if(|asked| *asked == question)?;
        let desired = match answer {
            Some(answer) => read_reply::<Desired>(Ok(answer)),
            None => Err(Failure::Unanswered),
        };
        node.schedule.pull_ended(&desired, now.at);
        let desired = desired.ok()?;
        node.statuses.follow(&desired);
        if !take(&desired, &node.parts.settings, &node.parts.board) {
            return None;
        }
        node.statuses.full_is_due();
        Some(Taken {
            revision: desired.revision,
            setting: desired.setting?,
        })
    }

    pub(super) fn set_by_hand(&self, value: f64) {
        if let Some(node) = &self.started {
            // A value out of range is refused.
            let _ = node.parts.settings.set_by_hand(&node.parts.board.cameras, value);
        }
    }

    /// The highest revision that it was given.
    pub(super) fn revision(&self) -> u64 {
        known(&self.started.as_ref().unwrap().parts.settings).revision()
    }

    /// True if the setting is in force.
    pub(super) fn has(&self, setting: DesiredSetting) -> bool {
        let board = &self.started.as_ref().unwrap().parts.board;
        let target = board.target.report().target;
        match setting {
            DesiredSetting::Threshold(wanted) => {
                target.is_none() && thresholds(board) == [wanted.value; 2]
            }
            DesiredSetting::Target(wanted) => target == wanted,
        }
    }

    /// True if it refused the setting, or somebody set the threshold at the node since.
    pub(super) fn deviates(&self, setting: DesiredSetting) -> bool {
        let node = self.started.as_ref().unwrap();
        if known(&node.parts.settings).refused.is_some() {
            return true;
        }
        let board = &node.parts.board;
        match setting {
            DesiredSetting::Threshold(_) => board
                .cameras
                .iter()
                .any(|camera| camera.threshold_source() == SettingSource::Local),
            DesiredSetting::Target(_) => board.target.report().source == SettingSource::Local,
        }
    }

    pub(super) fn shown(&self) -> String {
        let board = &self.started.as_ref().unwrap().parts.board;
        let target = board.target.report().target;
        let values = thresholds(board);
        format!("{target:?}, {values:?} by revision {}", self.revision())
    }
}
