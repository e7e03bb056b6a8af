//! Applies settings in the order in which they arrive: by Zenoh, where of several puts on a key only the newest counts, by
//! HTTP, and from the hub.

use super::Settings;
use super::transaction::{POLICY, SCREEN, TARGET, Transaction, of_threshold};
use crate::state::board::CameraBoard;
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{
    PolicyMessage, ScreenMessage, SettingSource, TargetMessage, ThresholdMessage, check_version,
};
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::error::Error;
use std::slice::from_ref;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::sync::Notify;

/// The largest message that is read; a valid one has a few dozen bytes.
pub(crate) const MAX_MESSAGE_BYTES: usize = 4096;

/// The time between two log lines about puts of one kind.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// How much older than a later setting a put can be that is still on its way. What seems older still was stamped by a wrong
/// clock, and counts by its arrival.
const LONGEST_WAY: Duration = Duration::from_secs(60);

/// The place of a setting among all that arrived, and when it arrived.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    number: u64,
    at: SystemTime,
}

/// A setting with a key of its own.
#[derive(Clone, Debug)]
pub(crate) enum Setting {
    /// The threshold of a camera.
    Threshold(Arc<CameraBoard>),
    /// The node's policy.
    Policy,
    /// The node's target.
    Target,
    /// The pauses of the node.
    Screen,
}

impl Setting {
    /// Its name among the kept settings.
    fn name(&self) -> String {
        match self {
            Self::Threshold(camera) => of_threshold(camera.name()),
            Self::Policy => POLICY.to_owned(),
            Self::Target => TARGET.to_owned(),
            Self::Screen => SCREEN.to_owned(),
        }
    }
}

/// A put that is not applied yet.
#[derive(Debug)]
struct Put {
    place: Place,
    /// When its sender or the first router stamped it, if one did.
    made: Option<SystemTime>,
    setting: Setting,
    payload: Vec<u8>,
    /// Earlier puts on the key that it replaced.
    replaced: u64,
}

#[derive(Debug, Default)]
struct Arrived {
    count: u64,
    /// The newest put of each key.
    puts: BTreeMap<String, Put>,
}

impl Arrived {
    fn place(&mut self) -> Place {
        self.count += 1;
        Place {
            number: self.count,
            at: SystemTime::now(),
        }
    }
}

/// The settings that arrived, and the turn of the one being applied.
#[derive(Debug)]
pub(crate) struct Turns {
    arrived: Mutex<Arrived>,
    /// Held while a setting is applied and its file is written: no async worker locks it.
    turn: Mutex<()>,
    /// When each setting last arrived by HTTP or from the hub, by its name.
    set_at: Mutex<BTreeMap<String, SystemTime>>,
    /// Notified for each put.
    pub(crate) changed: Notify,
    refused: RateLimit,
}

impl Default for Turns {
    fn default() -> Self {
        Self {
            arrived: Mutex::default(),
            turn: Mutex::default(),
            set_at: Mutex::default(),
            changed: Notify::new(),
            refused: RateLimit::new(LOG_PERIOD),
        }
    }
}

impl Turns {
    /// Gives a setting its place, when it arrives. Never waits for the disk.
    pub(crate) fn place(&self) -> Place {
        self.arrived.lock().place()
    }

    /// Keeps a put on `key` until its turn, in place of an earlier one on this key. `made` is its time stamp, if it has one.
    /// Never waits for the disk.
    pub(crate) fn put(
        &self,
        key: &str,
        setting: &Setting,
        made: Option<SystemTime>,
        payload: Vec<u8>,
    ) {
        let mut arrived = self.arrived.lock();
        let place = arrived.place();
        let put = Put {
            place,
            made,
            setting: setting.clone(),
            payload,
            replaced: arrived.puts.get(key).map_or(0, |put| put.replaced + 1),
        };
        arrived.puts.insert(key.to_owned(), put);
        drop(arrived);
        self.changed.notify_one();
    }

    /// By how much a put is older than the same setting by HTTP or from the hub: it was still on its way when that arrived,
    /// and must not take its place.
    fn overtaken_by(&self, put: &Put) -> Option<Duration> {
        let set_at = *self.set_at.lock().get(&put.setting.name())?;
        let older = set_at.duration_since(put.made?).ok()?;
        (older > Duration::ZERO && older <= LONGEST_WAY).then_some(older)
    }

    /// Takes the first put that arrived before `place`; without a place, the first of all.
    fn next(&self, place: Option<Place>) -> Option<(String, Put)> {
        let mut arrived = self.arrived.lock();
        let is_before = |put: &Put| place.is_none_or(|place| put.place.number < place.number);
        let puts = arrived.puts.iter().filter(|(_, put)| is_before(put));
        let (key, _) = puts.min_by_key(|(_, put)| put.place.number)?;
        let key = key.clone();
        arrived.puts.remove_entry(&key)
    }
}

impl Settings {
    /// Applies the puts that arrived before `place`, and then calls `set`, before any later one. May write a file.
    pub(crate) fn in_turn<T>(&self, place: Place, set: impl FnOnce() -> T) -> T {
        let _turn = self.turns.turn.lock();
        self.apply_before(Some(place));
        set()
    }

    /// Applies the puts that arrived before `place`, or all. The caller holds the turn.
    fn apply_before(&self, place: Option<Place>) {
        while let Some((key, put)) = self.turns.next(place) {
            if put.replaced > 0 {
                let replaced = put.replaced;
                tracing::debug!(key, replaced, "the newest of several puts is applied");
            }
            let applied = match self.turns.overtaken_by(&put) {
                Some(older) => {
                    let reason = format!(
                        "it was made {:.3} s before the setting in force, which came by HTTP or from the hub",
                        older.as_secs_f64()
                    );
                    Err(reason.into())
                }
                None => self.apply(&put.setting, &put.payload),
            };
            if let Err(reason) = applied {
                self.turns.refused.log(|held_back| {
                    tracing::warn!(key, held_back, "put rejected: {reason}");
                });
            }
        }
    }

    /// Applies all puts that have arrived. May write a file.
    pub(crate) fn apply_puts(&self) {
        let _turn = self.turns.turn.lock();
        self.apply_before(None);
    }

    /// Sets settings that came by HTTP or from the hub, in their turn. Writes a small file.
    pub(crate) fn set_in_turn<T>(
        &self,
        place: Place,
        settings: impl FnOnce(&mut Transaction<'_>) -> T,
    ) -> T {
        self.in_turn(place, || {
            let (set, names) = self.set(|transaction| {
                let set = settings(transaction);
                (set, transaction.names())
            });
            let times = names.into_iter().map(|name| (name, place.at));
            self.turns.set_at.lock().extend(times);
            set
        })
    }

    /// Changes a setting to the value in `payload`. Writes a small file.
    pub(crate) fn apply(
        &self,
        setting: &Setting,
        payload: &[u8],
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        if payload.len() > MAX_MESSAGE_BYTES {
            let most = MAX_MESSAGE_BYTES;
            return Err(format!("a message has at most {most} bytes; this one has more").into());
        }
        let local = SettingSource::Local;
        match setting {
            Setting::Threshold(camera) => {
                let example = r#"{"threshold":{"name":"u","value":3e-4}}"#;
                let ThresholdMessage { v, threshold } = read(payload, example)?;
                check_version(v)?;
                self.set(|transaction| transaction.thresholds(from_ref(camera), threshold, local))?;
            }
            Setting::Policy => {
                let example = r#"{"policy":{"name":"expected-loss"}}"#;
                let PolicyMessage { v, policy } = read(payload, example)?;
                check_version(v)?;
                self.set(|transaction| transaction.policy(&policy.name))?;
            }
            Setting::Target => {
                let TargetMessage { v, target } = read(payload, r#"{"target":{"skip_rate":0.5}}"#)?;
                check_version(v)?;
                self.set(|transaction| transaction.target(target, local))?;
            }
            Setting::Screen => {
                let ScreenMessage { v, screen } = read(payload, r#"{"screen":{"pause_s":0.2}}"#)?;
                check_version(v)?;
                self.set(|transaction| transaction.pauses(screen))?;
            }
        }
        Ok(())
    }
}

/// Reads a message. `v` may be missing, as in a put typed by hand, so the versioned reader does not fit.
fn read<T: DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload)
        .map_err(|error| format!("expected JSON such as {example}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PreparedNode;
    use crate::settings::tests::{config, prepared, thresholds};
    use albireo_core::policy::EmptyRoad;
    use albireo_wire::Threshold;
    use std::thread;

    const BURST: u64 = 20_000;

    fn value(number: u64) -> f64 {
        2e-4 + number as f64 * 1e-9
    }

    fn put(node: &PreparedNode, camera: usize, value: f64) {
        put_made(node, camera, value, None);
    }

    fn put_made(node: &PreparedNode, camera: usize, value: f64, made: Option<SystemTime>) {
        let camera = &node.board.cameras[camera];
        let setting = Setting::Threshold(Arc::clone(camera));
        let payload = format!(r#"{{"threshold":{{"name":"u","value":{value}}}}}"#);
        node.settings.turns.put(
            &camera.keys.threshold(),
            &setting,
            made,
            payload.into_bytes(),
        );
    }

    fn set_by_http(node: &PreparedNode, place: Place, value: f64) {
        let threshold = Threshold::new("u", value);
        let cameras = &node.board.cameras;
        let set = |transaction: &mut Transaction<'_>| {
            transaction.thresholds(cameras, threshold, SettingSource::Local)
        };
        node.settings.set_in_turn(place, set).unwrap();
    }

    #[test]
    fn the_last_put_of_a_burst_is_in_force_and_survives_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let config = config(Some(folder.path()), "albireo");
        let node = prepared(&config);
        thread::scope(|scope| {
            let stalled = node.settings.stall();
            put(&node, 0, 1e-4);
            scope.spawn(|| node.settings.apply_puts());
            while thresholds(&node.board)[0] != 1e-4 {
                thread::yield_now();
            }
            for number in 0..BURST {
                put(&node, 0, value(number));
                put(&node, 1, value(BURST - number));
            }
            drop(stalled);
        });
        node.settings.apply_puts();
        let wanted = [value(BURST - 1), value(1)];
        assert_eq!(thresholds(&node.board), wanted);
        drop(node);
        assert_eq!(thresholds(&prepared(&config).board), wanted);
    }

    #[test]
    fn no_put_overrides_a_later_request_and_no_request_a_later_put() {
        let node = prepared(&config(None, "albireo"));
        for number in 0..BURST {
            put(&node, 0, value(number));
        }
        let place = node.settings.turns.place();
        put(&node, 1, 4e-4);
        set_by_http(&node, place, 7e-4);
        assert_eq!(thresholds(&node.board), [7e-4; 2]);
        node.settings.apply_puts();
        assert_eq!(thresholds(&node.board), [7e-4, 4e-4]);
    }

    #[test]
    fn a_pause_comes_by_its_key_too_and_a_wrong_one_says_why() {
        let node = prepared(&config(None, "albireo"));
        let set = |payload: &str| node.settings.apply(&Setting::Screen, payload.as_bytes());
        set(r#"{"screen":{"pause_s":0.2}}"#).unwrap();
        set(r#"{"v":1,"screen":{"still_s":10}}"#).unwrap();
        let now = node.board.empty_road();
        let expected = EmptyRoad {
            pause_s: 0.2,
            after_s: 1.0,
            still_s: 10.0,
        };
        assert_eq!(now, expected);
        for (payload, words) in [
            (r#"{"screen":{"pause_s":99}}"#, "from 0 to 60"),
            (r#"{"screen":{"pause":1}}"#, "unknown field `pause`"),
            (r#"{"screen":{}}"#, "names no pause"),
            (r#"{"v":2,"screen":{"pause_s":0}}"#, "version 2"),
        ] {
            let refused = set(payload).unwrap_err().to_string();
            assert!(refused.contains(words), "{refused}");
        }
        assert_eq!(node.board.empty_road(), now);
    }

    #[test]
    fn the_policy_comes_by_its_key_too_and_a_wrong_one_says_why() {
        let node = prepared(&config(None, "albireo"));
        let set = |payload: &str| node.settings.apply(&Setting::Policy, payload.as_bytes());
        set(r#"{"policy":{"name":"expected-loss"}}"#).unwrap();
        assert_eq!(node.board.policy().name, "expected-loss");
        let refused = set(r#"{"policy":{"name":"albirio"}}"#).unwrap_err().to_string();
        assert!(refused.contains("did you mean `albireo`?"), "{refused}");
    }

    #[test]
    fn a_put_that_was_on_its_way_does_not_override_a_request_made_after_it() {
        let node = prepared(&config(None, "albireo"));
        let place = node.settings.turns.place();
        let ago = |seconds: u64| Some(place.at - Duration::from_secs(seconds));
        set_by_http(&node, place, 7e-4);
        put_made(&node, 0, 4e-4, ago(1));
        node.settings.apply_puts();
        assert_eq!(thresholds(&node.board), [7e-4; 2]);
        // Made later, stamped by nobody, and stamped by a clock that is an hour behind.
        let later = Some(place.at + Duration::from_secs(1));
        for (value, made) in [(3e-4, later), (5e-4, None), (6e-4, ago(3600))] {
            put_made(&node, 0, value, made);
            node.settings.apply_puts();
            assert_eq!(thresholds(&node.board), [value, 7e-4]);
        }
    }
}
