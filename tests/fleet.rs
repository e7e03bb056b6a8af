//! A small fleet of real processes: no report is lost or doubled when they are killed or frozen, or disks are full.

use crate::support::camera::Camera;
use crate::support::fleet::{
    HubProcess, Protected, Settings, behind, from_environment, router, sqlite,
};
use crate::support::postgres::Postgres;
use crate::support::{
    Node, PATIENCE, albireo_on_a_disk_that_fills, free_port, limit, metric, signal, text_at, until,
    zenoh_client,
};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rstest::rstest;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use tokio::process::Child;

/// A node and its camera, through kills and restarts.
pub(crate) struct Car {
    pub(crate) name: String,
    settings: String,
    pub(crate) node: Option<Node>,
    camera: Option<Camera>,
    /// The node's folder, while it does not run.
    folder: Option<tempfile::TempDir>,
    seq: u64,
    /// The clips whose reports the node published before a kill, all of which were on its disk.
    reported: BTreeSet<String>,
}

impl Car {
    pub(crate) fn new(policy: &str, name: &str, router: &str) -> Self {
        let (folder, settings) = crate::delivery::folder(policy);
        let settings = format!(
            "node.name = \"{name}\"\n{settings}uplink.connect = [\"{router}\"]\n\
             # development: reconnect_max_ms=500\n"
        );
        Self {
            name: name.to_owned(),
            settings,
            node: None,
            camera: None,
            folder: Some(folder),
            seq: 0,
            reported: BTreeSet::new(),
        }
    }

    pub(crate) async fn start(&mut self) {
        let folder = self.folder.take().unwrap();
        let node = Node::start_as(albireo_on_a_disk_that_fills(), folder, &self.settings).await;
        let mut camera = Camera::at(&node.zenoh, &self.name).await;
        camera.seq = self.seq;
        self.node = Some(node);
        self.camera = Some(camera);
    }

    pub(crate) async fn drive(&mut self, clips: u64) {
        self.camera.as_mut().unwrap().clips(clips).await;
    }

    /// Kills the node while frames are on their way.
    async fn kill(&mut self, after: Duration) {
        tokio::select! {
            () = self.drive(1000) => {}
            () = tokio::time::sleep(after) => {}
        }
        self.end().await;
    }

    pub(crate) async fn end(&mut self) {
        let mut camera = self.camera.take().unwrap();
        // A frame that was sent without an answer has used its number.
        self.seq = camera.seq;
        self.folder = Some(self.node.take().unwrap().kill().await);
        self.reported.append(camera.reported());
        camera.close().await;
    }

    /// Waits until the last closed clip is on the disk and the hub has acknowledged everything.
    async fn until_delivered(&mut self) {
        let http = &self.node.as_ref().unwrap().http;
        let camera = self.camera.as_mut().unwrap();
        let last = format!("clip-{}", camera.seq - 2);
        let mut kept = || camera.reported().contains(&last);
        let waiting = async || metric(http, "albireo_outbox_waiting").await;
        let what = format!("{}: {last} is delivered", self.name);
        until(&what, async || kept() && waiting().await == 0.0).await;
    }
}

/// Ends a node, and asserts that the hub has every report that it made according to its disk exactly once.
async fn every_report_once(hub: &HubProcess, mut car: Car) -> u64 {
    car.end().await;
    let file = car.folder.as_ref().unwrap().path().join("state/node.db");
    let db = rusqlite::Connection::open(file).unwrap();
    let made = "SELECT value FROM counter WHERE name = 'made'";
    let made: i64 = db.query_row(made, [], |row| row.get(0)).unwrap();
    let name = &car.name;
    let made = made.unsigned_abs();
    let reported = &car.reported;
    let clips = hub.has_each_once(name, made).await;
    let clips = clips.iter().map(|clip| clip["clip"].as_str().unwrap());
    let clips: BTreeSet<String> = clips.map(str::to_owned).collect();
    let count = clips.len() as u64;
    assert_eq!(count, made, "{name}: no clip under two numbers");
    let lost: Vec<_> = reported.difference(&clips).collect();
    assert!(lost.is_empty(), "{name}: {lost:?} are lost");
    assert!(!reported.is_empty(), "{name}: no reports were published");
    made
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_node_sends_counters_and_pictures_over_its_uplink_only_while_somebody_watches() {
    let (endpoint, hub) = HubProcess::fresh(vec![]).await;
    let mut car = Car::new("vanilla", "car-1", &endpoint);
    car.settings += "uplink.pictures = true\n";
    car.start().await;
    car.drive(2).await;
    hub.until("/api/v1/nodes/car-1", |node| {
        node["status"]["cameras"][0]["name"] == "front"
    })
    .await;
    let listener = zenoh_client(&endpoint).await;
    let counters = listener.declare_subscriber("albireo/car-1/*/counters").await.unwrap();
    // Nobody watches the node: it serves no picture, and three polls of the uplink's thread send no counters.
    let nothing = listener.get("albireo/car-1/front/picture").await.unwrap();
    assert!(nothing.recv_async().await.is_err());
    let silence = tokio::time::timeout(Duration::from_secs(3), counters.recv_async()).await;
    assert!(silence.is_err(), "{silence:?}");

    let mut live = reqwest::get(format!("{}/api/v1/nodes/car-1/live", hub.http)).await.unwrap();
    let mut text = String::new();
    while !text.contains("\"camera\":\"front\"") {
        let chunk = live.chunk().await.unwrap().unwrap();
        text.push_str(&String::from_utf8_lossy(&chunk));
    }
    assert!(text.contains("event: counters"), "{text}");
    counters.recv_async().await.unwrap();
    let path = format!("{}/api/v1/nodes/car-1/cameras/front/frame.jpg", hub.http);
    let picture = reqwest::get(&path).await.unwrap();
    assert_eq!(picture.status(), 200);
    assert!(picture.headers().contains_key("albireo-frame"));
    assert!(picture.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));

    car.end().await;
    car.settings = car.settings.replace("pictures = true", "pictures = false");
    car.start().await;
    car.drive(1).await;
    until("it is refused", async || {
        text_at(&path).await.contains("uplink.pictures")
    })
    .await;
    assert_eq!(reqwest::get(&path).await.unwrap().status(), 404);
}

/// The hub and the router as parts that fail, beside cars 0 and 1; the database server is the last one.
const HUB: usize = 2;
const ROUTER: usize = 3;
const DATABASE: usize = 4;

struct Fleet {
    endpoint: String,
    /// With access control.
    protected: Option<Protected>,
    settings: Settings,
    /// A server, or `None` for a SQLite file of the hub.
    database: Option<Postgres>,
    database_up: bool,
    router: Option<Child>,
    hub: Option<HubProcess>,
    cars: Vec<Car>,
}

impl Fleet {
    /// Starts a part, unless it runs.
    async fn start(&mut self, part: usize) {
        match part {
            DATABASE if !self.database_up => {
                self.database.as_ref().unwrap().up();
                self.database_up = true;
            }
            ROUTER if self.router.is_none() => {
                self.router = Some(match &self.protected {
                    Some(protected) => protected.start_router().await,
                    None => router(&self.endpoint),
                });
            }
            HUB if self.hub.is_none() => {
                let command = albireo_on_a_disk_that_fills();
                self.hub = Some(HubProcess::start_as(command, &self.settings));
            }
            0 | 1 if self.cars[part].node.is_none() => self.cars[part].start().await,
            _ => {}
        }
    }

    async fn kill(&mut self, part: usize, after: Duration) {
        match part {
            DATABASE => {
                self.database.as_ref().unwrap().kill();
                self.database_up = false;
            }
            ROUTER => self.router.take().unwrap().kill().await.unwrap(),
            HUB => self.hub.take().unwrap().kill().await,
            _ => self.cars[part].kill(after).await,
        }
    }

    /// Starts the parts that do not run, the database first.
    async fn heal(&mut self) {
        for part in (0..=DATABASE).rev() {
            self.start(part).await;
        }
    }

    /// Sends frames to the running cars but one.
    async fn drive_without(&mut self, part: usize) {
        for (index, car) in self.cars.iter_mut().enumerate() {
            if index != part && car.node.is_some() {
                car.drive(2).await;
            }
        }
    }

    /// The process of a car, the hub or the router, and where it answers.
    fn process(&self, part: usize) -> (u32, String) {
        let car = self.cars.get(part);
        let hub = self.hub.as_ref();
        match (car.and_then(|car| car.node.as_ref()), hub) {
            (Some(node), _) => (node.id(), node.http.clone()),
            (None, Some(hub)) if part == HUB => (hub.id(), hub.http.clone()),
            _ => (self.router.as_ref().unwrap().id().unwrap(), String::new()),
        }
    }

    /// Stops a process, and lets it go on later than its peers wait for an answer.
    async fn freeze(&mut self, part: usize, pause: Duration) {
        self.start(part).await;
        let (process, _) = self.process(part);
        signal(process, "-STOP");
        self.drive_without(part).await;
        tokio::time::sleep(pause).await;
        signal(process, "-CONT");
    }

    /// Fills the disk of a car or the hub until it says so, and then makes space again.
    async fn fill_disk(&mut self, part: usize) {
        self.heal().await;
        let (process, http) = self.process(part);
        let reason = if part == HUB {
            "\"database\""
        } else {
            "\"outbox\""
        };
        let faulty = async || text_at(&format!("{http}/readyz")).await.contains(reason);
        until("it works", async || !faulty().await).await;
        limit(process, "--fsize=4096:");
        until("its disk is full", async || {
            self.drive_without(DATABASE).await;
            faulty().await
        })
        .await;
        limit(process, "--fsize=unlimited:");
        until("it writes again", async || !faulty().await).await;
    }
}

#[rstest]
#[ignore = "needs ONNX Runtime and Python"]
#[case::sqlite(None, false)]
#[ignore = "needs ONNX Runtime and Python and PostgreSQL"]
#[case::postgresql(Some(Postgres::start()), false)]
#[ignore = "needs ONNX Runtime"]
#[case::sqlite_with_access_control(None, true)]
#[ignore = "needs ONNX Runtime and PostgreSQL"]
#[case::postgresql_with_access_control(Some(Postgres::start()), true)]
#[timeout(10 * PATIENCE)]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn kills_freezes_and_full_disks_in_any_order_lose_and_duplicate_no_report(
    #[case] database: Option<Postgres>,
    #[case] with_access_control: bool,
) {
    // More by hand: ALBIREO_KILLS=240; another order: ALBIREO_SEED=7.
    let kills = from_environment("ALBIREO_KILLS", if with_access_control { 6 } else { 12 });
    let mut random = Pcg64Mcg::seed_from_u64(from_environment("ALBIREO_SEED", 1));
    let folder = tempfile::tempdir().unwrap();
    let cars = ["car-1", "car-2"];
    let protected = with_access_control.then(|| Protected::new(cars));
    let endpoint = match &protected {
        Some(protected) => protected.endpoint.clone(),
        None => format!("tcp/127.0.0.1:{}", free_port()),
    };
    let (url, parts, disks) = match &database {
        Some(server) => (server.url(), 5, 2),
        None => (sqlite(folder.path()), 4, 3),
    };
    let car = |name| {
        let mut car = Car::new("vanilla", name, &endpoint);
        car.settings += &protected.as_ref().map_or_else(String::new, |it| it.certificate(name));
        car
    };
    let mut fleet = Fleet {
        settings: match &protected {
            Some(protected) => protected.hub(&url),
            None => behind(&endpoint, &url),
        },
        cars: cars.map(car).into(),
        protected,
        endpoint,
        database_up: true,
        database,
        router: None,
        hub: None,
    };
    fleet.heal().await;
    let begun = Instant::now();
    let mut killed = [0; 5];
    let mut frozen = [0; 4];
    let mut filled = [0; 3];
    for kill in 0..kills {
        let mut below = |bound: u64| random.next_u64() % bound;
        let part = below(parts) as usize;
        let after = Duration::from_millis(below(80));
        fleet.drive_without(DATABASE).await;
        if below(4) == 0 {
            let part = below(4) as usize;
            frozen[part] += 1;
            fleet.freeze(part, Duration::from_millis(below(2000))).await;
        }
        if below(6) == 0 {
            let part = below(disks) as usize;
            filled[part] += 1;
            fleet.fill_disk(part).await;
        }
        killed[part] += 1;
        tokio::time::sleep(after).await;
        fleet.start(part).await;
        fleet.kill(part, after).await;
        // Often the next part is killed while this one is still down.
        if below(2) == 0 {
            fleet.heal().await;
        }
        if kill % 12 == 11 {
            fleet.heal().await;
            fleet.cars[0].drive(2).await;
            fleet.cars[0].until_delivered().await;
        }
    }
    fleet.heal().await;
    for car in &mut fleet.cars {
        car.drive(2).await;
        car.until_delivered().await;
    }
    let took = begun.elapsed();
    let hub = fleet.hub.take().unwrap();
    let mut stored = 0;
    for car in std::mem::take(&mut fleet.cars) {
        stored += every_report_once(&hub, car).await;
    }
    println!(
        "{kills} kills in {took:.0?}, by part: {killed:?}, frozen {frozen:?}, full disks {filled:?}: \
         {stored} reports, each stored once"
    );
    assert!(stored > kills);
}
