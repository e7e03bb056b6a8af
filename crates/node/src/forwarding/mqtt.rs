//! Publishes what the cameras see to an MQTT broker: retained states, sightings as events, and what Home Assistant discovers.

use super::address::Endpoint;
use super::config::MqttConfig;
use super::discovery::{
    Described, DiscoveryMessage, MOST_CLASSES, NamedClass, camera_ids, id_of, named,
};
use super::mailbox::{Mailbox, WINDOW};
use super::{FIRST_PAUSE_MS, LONGEST_PAUSE_MS};
use crate::backoff::Backoff;
use crate::state::board::{Board, CameraBoard, Forwarded};
use crate::state::readiness;
use albireo_service::connection::Connector;
use albireo_service::readiness::Part;
use albireo_vision::detector::named_classes;
use albireo_wire::{EnergyQuality, Sighting, SightingEvent};
use rumqttc::{
    AsyncClient, ConnectReturnCode, ConnectionError, Event, LastWill, MqttOptions, Outgoing,
    Packet, PublishOptions, QoS,
};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep, timeout};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

/// The time between two rounds, in which counts and availability are published.
const ROUND: Duration = Duration::from_secs(1);

/// So many rounds to one message with figures.
const ROUNDS_PER_FIGURES: u32 = 10;

/// A connection that lasted this long was a good one: the next attempt follows soon.
const LASTED: Duration = Duration::from_secs(60);

/// Seconds without a word after which the broker takes the node for lost, times 1.5.
const KEEP_ALIVE_S: u16 = 20;

/// A camera without a frame for this long is not available.
const CAMERA_SILENCE: Duration = Duration::from_secs(30);

/// The time for saying goodbye.
const GOODBYE: Duration = Duration::from_millis(500);

/// The longest message from a broker, bytes.
const LARGEST_RECEIVED: usize = 16 << 10;

/// The longest message to a broker, bytes.
const LARGEST_SENT: usize = 256 << 10;

const ONLINE: &str = "online";
const OFFLINE: &str = "offline";

/// What a node tells a broker of itself.
pub(crate) struct MqttSetup {
    /// The section `[mqtt]`.
    pub config: MqttConfig,
    /// What is told.
    pub board: Arc<Board>,
    /// First part of all keys and topics.
    pub prefix: String,
    /// The classes that the detector reports.
    pub classes: Vec<String>,
    /// The address of the node's own page.
    pub page: Option<String>,
    /// Differs between nodes.
    pub random: u64,
}

/// The node's client of a broker.
pub(crate) struct Mqtt {
    config: MqttConfig,
    connector: Connector,
    place: Endpoint,
    board: Arc<Board>,
    described: Described,
    classes: Vec<NamedClass>,
    mailbox: Mailbox,
    counts: Arc<Forwarded>,
    part: Part,
    backoff: Backoff,
    sightings: broadcast::Receiver<Arc<Sighting>>,
    rounds: Interval,
    /// The number of rounds so far.
    round: u32,
}

impl Mqtt {
    /// Prepares the client of the configured broker, if there is one. It hears of sightings from now on.
    ///
    /// # Errors
    /// Why the broker's address or a certificate cannot be used.
    pub(crate) fn new(setup: MqttSetup) -> Result<Option<Self>, String> {
        let Some(place) = setup.config.place().transpose()? else {
            return Ok(None);
        };
        let authority = setup.config.root_ca_certificate.as_deref();
        let connector = place.connector(authority)?;
        let MqttSetup { board, prefix, .. } = setup;
        let node = board.node.clone();
        let counts = board.forward_to(place.to_string());
        let classes = named(&setup.classes);
        if named_classes(&setup.classes).len() > MOST_CLASSES {
            tracing::warn!(
                "MQTT tells of the first {MOST_CLASSES} classes of the model: name those that matter in detector.report_classes"
            );
        }
        let mut rounds = interval(ROUND);
        rounds.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Ok(Some(Self {
            described: Described {
                discovery: setup.config.discovery.clone(),
                base: format!("{prefix}/{node}"),
                id: id_of(&format!("{prefix}_{node}")),
                node,
                model: board.model.clone(),
                page: setup.page,
            },
            part: board.readiness.part(readiness::MQTT),
            sightings: board.sightings(),
            backoff: Backoff::new(FIRST_PAUSE_MS, LONGEST_PAUSE_MS, setup.random),
            config: setup.config,
            mailbox: Mailbox::default(),
            round: 0,
            connector,
            place,
            board,
            classes,
            counts,
            rounds,
        }))
    }

    /// Publishes until `shutdown`; connects again whenever the connection is lost.
    pub(crate) async fn run(mut self, shutdown: CancellationToken) {
        loop {
            let begun = Instant::now();
            let Err(reason) = self.session(&shutdown).await else {
                break;
            };
            self.counts.failed();
            let lost = self.mailbox.disconnected();
            self.counts.dropped(lost);
            self.part.degraded(format!("{}: {reason}", self.place));
            if begun.elapsed() > LASTED {
                self.backoff.reset();
            }
            if !self.pause(&shutdown).await {
                break;
            }
        }
        let lost = self.mailbox.waiting() as u64;
        self.counts.dropped(lost);
    }

    /// Waits before the next attempt. Returns false at the shutdown.
    async fn pause(&mut self, shutdown: &CancellationToken) -> bool {
        let over = sleep(self.backoff.next());
        tokio::pin!(over);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return false,
                () = &mut over => return true,
                sighting = self.sightings.recv() => self.take(sighting),
                _ = self.rounds.tick() => self.publish_round(),
            }
        }
    }

    /// One connection: returns at the shutdown, or the reason why it ended.
    async fn session(&mut self, shutdown: &CancellationToken) -> Result<(), String> {
        let will = format!("{}/availability", self.described.base);
        let mut options = options(
            &self.config,
            &self.connector,
            &self.place,
            &self.described.id,
        )?;
        let is_retained = true;
        let last_will = LastWill::new(will.as_str(), OFFLINE, QoS::AtLeastOnce, is_retained);
        options.set_last_will(last_will);
        let (client, mut heard, _driver) = connect(options)?;
        let mut is_connected = false;
        loop {
            tokio::select! {
                () = shutdown.cancelled() => {
                    if is_connected {
                        self.leave(&client, &mut heard, &will).await;
                    }
                    return Ok(());
                }
                event = heard.recv() => match event {
                    Some(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                        is_connected = true;
                        self.part.works();
                        self.mailbox.set(will.clone(), ONLINE.to_owned());
                        tracing::info!(broker = %self.place, "connected to the MQTT broker");
                    }
                    Some(Ok(Event::Outgoing(Outgoing::Publish(number)))) => self.mailbox.numbered(number),
                    Some(Ok(Event::Incoming(Packet::PubAck(answer)))) => {
                        if self.mailbox.acknowledged(answer.pkid) {
                            self.counts.sent();
                        }
                    }
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(reason_of(&error)),
                    None => return Err("the connection ended".to_owned()),
                },
                sighting = self.sightings.recv() => self.take(sighting),
                _ = self.rounds.tick() => self.publish_round(),
            }
            while is_connected && let Some(message) = self.mailbox.next() {
                let how = PublishOptions::at_least_once().retain(message.is_retained);
                let given = client.try_publish(message.topic, message.payload, how);
                // The window is smaller than the channel.
                given.map_err(|error| error.to_string())?;
            }
        }
    }

    /// Says goodbye: otherwise the broker would wait, and then publish the last will.
    async fn leave(&mut self, client: &AsyncClient, heard: &mut Heard, topic: &str) {
        let how = PublishOptions::at_least_once().retain(true);
        if client.try_publish(topic.to_owned(), OFFLINE, how).is_err() {
            return;
        }
        if client.try_disconnect().is_err() {
            return;
        }
        let ended = async {
            while let Some(event) = heard.recv().await {
                if let Ok(Event::Incoming(Packet::PubAck(answer))) = event {
                    self.mailbox.acknowledged(answer.pkid);
                }
            }
        };
        let _ = timeout(GOODBYE, ended).await;
    }

    /// Takes a sighting: an event of its camera, and the state of its class.
    fn take(&mut self, heard: Result<Arc<Sighting>, RecvError>) {
        let sighting = match heard {
            Ok(sighting) => sighting,
            // The states are right again in the next round.
            Err(RecvError::Lagged(lost)) => return self.counts.dropped(lost),
            Err(RecvError::Closed) => return,
        };
        let base = format!("{}/{}", self.described.base, sighting.camera);
        let Some(one) = self.classes.iter().find(|one| one.class == sighting.class) else {
            return;
        };
        let is_there = sighting.event == SightingEvent::Appeared;
        self.mailbox.set(format!("{base}/class/{}", one.id), on_off(is_there));
        // A sighting can always be serialised.
        let event = serde_json::to_string(&*sighting).unwrap_or_default();
        let lost = self.mailbox.tell(format!("{base}/event"), event);
        self.counts.dropped(lost);
    }

    /// Publishes the states of the node and its cameras.
    fn publish_round(&mut self) {
        let board = Arc::clone(&self.board);
        let power = board.power();
        let quality = if power.quality == EnergyQuality::Unavailable {
            None
        } else {
            Some(power.quality.as_str())
        };
        let describes = !self.described.discovery.is_empty();
        if describes {
            let DiscoveryMessage { topic, payload } = self.described.node(quality);
            self.mailbox.set(topic, payload);
        }
        let shows_figures = self.round.is_multiple_of(ROUNDS_PER_FIGURES);
        self.round = self.round.wrapping_add(1);
        if shows_figures {
            let total = power.watts.iter().find(|one| one.domain == "total");
            let figures = json!({
                "state": board.readiness.health().state(),
                "watts": total.map(|one| (one.watts * 10.0).round() / 10.0),
                "power": quality,
            });
            self.mailbox.set(
                format!("{}/figures", self.described.base),
                figures.to_string(),
            );
        }
        let ids = camera_ids(board.cameras.iter().map(|camera| camera.name()));
        for (camera, id) in board.cameras.iter().zip(&ids) {
            if describes {
                let described = self.described.camera(camera.name(), id, &self.classes);
                self.mailbox.set(described.topic, described.payload);
            }
            self.publish_camera(camera, shows_figures);
        }
    }

    fn publish_camera(&mut self, camera: &CameraBoard, shows_figures: bool) {
        let base = format!("{}/{}", self.described.base, camera.name());
        let now = camera.snapshot();
        let is_live = now.last_frame_age().is_some_and(|age| age < CAMERA_SILENCE);
        let availability = if is_live { ONLINE } else { OFFLINE };
        self.mailbox.set(format!("{base}/availability"), availability.to_owned());
        let there = camera.classes_there();
        let mut counts = BTreeMap::<&str, u32>::new();
        for one in now.latest.iter().flat_map(|latest| &latest.boxes) {
            *counts.entry(&one.class).or_default() += 1;
        }
        for one in &self.classes {
            let topic = format!("{base}/class/{}", one.id);
            let count = counts.get(one.class.as_str()).copied().unwrap_or_default();
            self.mailbox.set(format!("{topic}/count"), count.to_string());
            self.mailbox.set(topic, on_off(there.contains(&one.class)));
        }
        if shows_figures {
            let calls: u64 = now.calls.by_cause().map(|(_, calls)| calls).sum();
            let figures = json!({
                "frames": now.states.frames(),
                "detector_calls": calls,
                "skip_rate": (now.skip_rate() * 1e4).round() / 1e4,
            });
            self.mailbox.set(format!("{base}/figures"), figures.to_string());
        }
    }

    /// Connects to the broker as a node would, and leaves at once, for `check --online`.
    pub(crate) async fn try_to_connect(config: &MqttConfig) -> Result<String, String> {
        let place = config.place().ok_or("no broker is set")??;
        let connector = place.connector(config.root_ca_certificate.as_deref())?;
        let id = format!("albireo-check-{}", std::process::id());
        let options = options(config, &connector, &place, &id)?;
        let (client, mut heard, _driver) = connect(options)?;
        while let Some(event) = heard.recv().await {
            match event {
                Ok(Event::Incoming(Packet::ConnAck(_))) => {
                    let _ = client.try_disconnect();
                    return Ok(format!("{place} lets this node in"));
                }
                Ok(_) => {}
                Err(error) => return Err(format!("{place}: {}", reason_of(&error))),
            }
        }
        Err(format!("{place}: the connection ended"))
    }
}

/// What a connection says.
type Heard = mpsc::Receiver<Result<Event, ConnectionError>>;

fn options(
    config: &MqttConfig,
    connector: &Connector,
    place: &Endpoint,
    id: &str,
) -> Result<MqttOptions, String> {
    let mut options = MqttOptions::new(id, (place.host.as_str(), place.port));
    options.set_keep_alive(KEEP_ALIVE_S);
    options.set_max_packet_size(LARGEST_RECEIVED, LARGEST_SENT);
    if let Some((user, password)) = config.login()? {
        options.set_credentials(user, password);
    }
    let connector = connector.clone();
    options.set_socket_connector(move |_, _| {
        let connector = connector.clone();
        async move { connector.open().await }
    });
    Ok(options)
}

/// Begins to connect. What drives the connection is a task of its own, because it must not be interrupted.
fn connect(options: MqttOptions) -> Result<(AsyncClient, Heard, AbortOnDropHandle<()>), String> {
    let (client, mut connection) = AsyncClient::builder(options)
        .capacity(2 * WINDOW)
        .try_build()
        .map_err(|error| error.to_string())?;
    let (say, heard) = mpsc::channel(2 * WINDOW);
    let driver = tokio::spawn(async move {
        loop {
            let event = connection.poll().await;
            let is_over = event.is_err();
            let said = say.send(event).await;
            if said.is_err() || is_over {
                return;
            }
        }
    });
    Ok((client, heard, AbortOnDropHandle::new(driver)))
}

fn on_off(is_there: bool) -> String {
    let state = if is_there { "ON" } else { "OFF" };
    state.to_owned()
}

/// The reason why a connection failed or ended, and what to do.
fn reason_of(error: &ConnectionError) -> String {
    match error {
        ConnectionError::ConnectionRefused(
            ConnectReturnCode::BadUserNamePassword | ConnectReturnCode::NotAuthorized,
        ) => "the broker refused the user or the password: see mqtt.user and mqtt.password_file"
            .to_owned(),
        ConnectionError::ConnectionRefused(code) => {
            format!("the broker refused the connection: {code:?}")
        }
        ConnectionError::Io(error) if error.kind() == std::io::ErrorKind::Other => {
            error.to_string()
        }
        ConnectionError::NetworkTimeout | ConnectionError::FlushTimeout => {
            "the broker does not answer".to_owned()
        }
        ConnectionError::MqttState(_) | ConnectionError::Io(_) => format!(
            "the broker closed the connection ({error}): is it going down, or is another client called like this node?"
        ),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests;
