//! Values reach nodes, rollouts go on, back and over a restart, trials compare: with simulated nodes over real sessions.

use crate::support::postgres::Postgres;
use crate::support::{Hub, PATIENCE, config, full_status, say, sqlite, uplink};
use albireo_hub::config::HubConfig;
use albireo_service::config::{NamedToken, Role, Token};
use albireo_simulate::{Behaviour, Options};
use reqwest::StatusCode;
use serde_json::{Value, json};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// A fleet that is played until it is dropped.
pub(crate) struct Played {
    stop: CancellationToken,
    task: Option<JoinHandle<Result<albireo_simulate::Summary, albireo_simulate::SimulateError>>>,
}

/// Few nodes that live fast.
pub(crate) fn fleet(nodes: usize) -> Options {
    Options {
        nodes,
        sessions: 2.min(nodes),
        duration: Duration::from_secs(600),
        status_s: 0.5,
        clip_s: 0.2,
        gather: 1,
        drain: Duration::from_secs(10),
        seed: 1,
        ..Options::default()
    }
}

impl Played {
    pub(crate) async fn begin(hub: &Hub, options: Options) -> Self {
        let options = Options {
            connect: hub.zenoh.clone(),
            ..options
        };
        let stop = CancellationToken::new();
        let count = options.nodes as u64;
        let task = tokio::spawn(albireo_simulate::run(options, stop.clone(), |_| {}));
        hub.until("/api/v1/nodes?limit=1000", |answer| {
            let known = |node: &&Value| node["status"]["cameras"][0]["threshold"]["value"].is_f64();
            let nodes = answer["nodes"].as_array().into_iter().flatten();
            nodes.filter(known).count() as u64 == count
        })
        .await;
        Self {
            stop,
            task: Some(task),
        }
    }

    pub(crate) async fn end(mut self) -> albireo_simulate::Summary {
        self.stop.cancel();
        let task = self.task.take().unwrap();
        tokio::time::timeout(PATIENCE, task)
            .await
            .unwrap()
            .unwrap()
            .unwrap()
    }
}

impl Drop for Played {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

pub(crate) async fn put(hub: &Hub, body: Value) -> (StatusCode, Value) {
    put_at(hub, "/api/v1/threshold", body).await
}

pub(crate) async fn put_at(hub: &Hub, path: &str, body: Value) -> (StatusCode, Value) {
    let request = reqwest::Client::new()
        .put(format!("{}{path}", hub.http))
        .json(&body);
    let response = request.send().await.unwrap();
    (response.status(), response.json().await.unwrap())
}

pub(crate) async fn post(hub: &Hub, path: &str, body: Value) -> (StatusCode, Value) {
    let request = reqwest::Client::new()
        .post(format!("{}{path}", hub.http))
        .json(&body);
    let response = request.send().await.unwrap();
    (response.status(), response.json().await.unwrap())
}

pub(crate) fn values(nodes: &Value) -> Vec<f64> {
    let nodes = nodes["nodes"].as_array().unwrap().iter();
    nodes
        .map(|node| {
            node["status"]["cameras"][0]["threshold"]["value"]
                .as_f64()
                .unwrap()
        })
        .collect()
}

async fn values_reach_nodes(database: &str) {
    let hub = Hub::start(config(database)).await;
    let played = Played::begin(&hub, fleet(6)).await;
    let dry = json!({"u": 5e-4, "select": ["sim-*"], "dry_run": true});
    let (status, answer) = put(&hub, dry).await;
    assert_eq!(
        (status, &answer["counts"]),
        (StatusCode::OK, &json!({"would_change": 6})),
        "{answer}"
    );
    assert_eq!(hub.get("/api/v1/changes").await["changes"], json!([]));

    let some = json!({"u": 5e-4, "select": "region=north,sim-000001,nobody", "why": "a test"});
    let (status, answer) = put(&hub, some).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    // Nodes 0 and 4 are in the north.
    assert_eq!(
        answer["counts"],
        json!({"applied": 3, "refused": 1}),
        "{answer}"
    );
    let mut found = values(&hub.get("/api/v1/nodes").await);
    assert_eq!(found, [5e-4, 5e-4, 3e-4, 3e-4, 5e-4, 3e-4]);
    let change = answer["revision"].as_u64().unwrap();
    let changes = hub.get("/api/v1/changes?node=sim-000004").await;
    let first = &changes["changes"][0];
    assert_eq!(
        (&first["revision"], &first["why"], &first["threshold"]),
        (&json!(change), &json!("a test"), &Value::Null)
    );
    assert_eq!(
        (&first["to"], &first["who"]),
        (
            &json!({"threshold": {"name": "u", "value": 5e-4}}),
            &json!("anonymous")
        )
    );
    let detail = hub.get(&format!("/api/v1/changes/{change}")).await;
    assert_eq!(
        detail["nodes"][0]["from"],
        json!({"threshold": {"name": "u", "value": 3e-4}})
    );
    assert_eq!(detail["nodes"][0]["outcome"], "applied");

    // The same again changes nobody; a value out of range is refused by the nodes, in their words.
    let (_, answer) = put(&hub, json!({"u": 5e-4, "select": ["sim-000001"]})).await;
    assert_eq!(
        (&answer["counts"], &answer["revision"]),
        (&json!({"unchanged": 1}), &Value::Null)
    );
    let (_, answer) = put(&hub, json!({"u": 7.0, "select": ["sim-000001"]})).await;
    assert_eq!(answer["counts"], json!({"refused": 1}), "{answer}");
    assert!(
        answer["nodes"][0]["detail"]
            .as_str()
            .unwrap()
            .contains("from 1e-9 to 1")
    );
    played.end().await;
    hub.stop().await;

    // What was desired is desired after a restart of the hub, and the revisions go on.
    let hub = Hub::start(config(database)).await;
    let played = Played::begin(&hub, fleet(6)).await;
    hub.until("/api/v1/nodes", |nodes| values(nodes)[..2] == [5e-4, 5e-4])
        .await;
    let (_, answer) = put(&hub, json!({"u": 1e-4, "select": "all"})).await;
    assert!(
        answer["revision"].as_u64().unwrap() > change + 1,
        "{answer}"
    );
    found = values(&hub.get("/api/v1/nodes").await);
    assert_eq!(found, [1e-4; 6]);
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_value_reaches_the_selected_nodes_and_is_applied_when_they_report_it() {
    let folder = tempfile::tempdir().unwrap();
    values_reach_nodes(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_value_reaches_the_selected_nodes_and_is_applied_when_they_report_it() {
    let server = Postgres::start();
    values_reach_nodes(&server.url()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_with_an_empty_database_is_obeyed_by_nodes_that_had_orders_before() {
    let (before, empty) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let hub = Hub::start(config(&sqlite(before.path()))).await;
    let played = Played::begin(&hub, fleet(4)).await;
    let mut last = Value::Null;
    for u in [1e-4, 2e-4, 1e-4, 2e-4] {
        let (_, answer) = put(&hub, json!({"u": u, "select": ["all"]})).await;
        assert_eq!(answer["counts"], json!({"applied": 4}), "{answer}");
        last = answer["revision"].clone();
    }
    let mut again = hub.config.clone();
    hub.stop().await;
    again.database.url = sqlite(empty.path());
    let hub = Hub::start(again).await;
    hub.until("/api/v1/nodes", |nodes| {
        nodes["nodes"].as_array().is_some_and(|nodes| {
            nodes.len() == 4 && nodes.iter().all(|node| node["revision"] == last)
        })
    })
    .await;
    let (_, answer) = put(&hub, json!({"u": 5e-4, "select": ["all"]})).await;
    assert_eq!(answer["counts"], json!({"applied": 4}), "{answer}");
    let revision = answer["revision"].as_u64();
    assert!(revision > last.as_u64(), "{answer}");

    // One that reports nonsense is named, and uses no revisions up.
    let session = uplink(&hub.zenoh).await;
    let liar = albireo_wire::StatusMessage {
        revision: 1 << 53,
        ..full_status(10, 1, &[])
    };
    say(&session, "liar", &liar).await;
    hub.until("/api/v1/nodes", |nodes| {
        nodes["nodes"]
            .as_array()
            .is_some_and(|nodes| nodes.len() == 5)
    })
    .await;
    let (_, answer) = put(&hub, json!({"u": 1e-4, "select": ["all"]})).await;
    let counts = json!({"applied": 4, "refused": 1});
    assert_eq!(answer["counts"], counts);
    assert!(answer["revision"].as_u64() < revision.map(|one| one + 1000));
    let liar = (answer["nodes"].as_array().unwrap().iter()).find(|line| line["node"] == "liar");
    let detail = liar.unwrap()["detail"].as_str().unwrap();
    assert!(detail.contains("revision 9007199254740992"), "{detail}");
    session.close().await.unwrap();
    played.end().await;
    hub.stop().await;
}

async fn a_gone_node_is_forgotten(database: &str) {
    let mut config = config(database);
    config.presence.silent_after_s = 2.0;
    config.presence.offline_after_s = 4.0;
    let hub = Hub::start(config).await;
    let played = Played::begin(&hub, fleet(2)).await;
    let (_, answer) = put(&hub, json!({"u": 1e-4, "select": ["all"]})).await;
    assert_eq!(answer["counts"], json!({"applied": 2}), "{answer}");
    let forget = async |hub: &Hub, node: &str| {
        let url = format!("{}/api/v1/nodes/{node}", hub.http);
        let answer = reqwest::Client::new().delete(url).send().await.unwrap();
        answer.status()
    };
    // One that is heard would be back at once.
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::CONFLICT);
    played.end().await;
    hub.until("/api/v1/nodes", |nodes| {
        nodes["counts"]["online"] == 0 && nodes["counts"]["degraded"] == 0
    })
    .await;
    // Ordered while it is away: dropped with it.
    let (_, answer) = put(
        &hub,
        json!({"u": 5e-4, "select": ["sim-000001"], "wait_s": 0}),
    )
    .await;
    let change = answer["revision"].as_u64().unwrap();
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::NO_CONTENT);
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::NOT_FOUND);
    let names = |nodes: &Value| -> Vec<String> {
        let nodes = nodes["nodes"].as_array().unwrap().iter();
        nodes
            .map(|node| node["node"].as_str().unwrap().to_owned())
            .collect()
    };
    assert_eq!(names(&hub.get("/api/v1/nodes").await), ["sim-000000"]);
    hub.until(&format!("/api/v1/changes/{change}"), |change| {
        change["nodes"][0]["outcome"] == "missed"
    })
    .await;

    // It stays forgotten over a restart, and is a new node when it comes back: nothing is desired of it.
    let again = hub.config.clone();
    hub.stop().await;
    let hub = Hub::start(again).await;
    assert_eq!(names(&hub.get("/api/v1/nodes").await), ["sim-000000"]);
    let played = Played::begin(&hub, fleet(2)).await;
    hub.until("/api/v1/nodes", |nodes| values(nodes) == [1e-4, 3e-4])
        .await;
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_is_gone_can_be_forgotten_with_what_was_desired_of_it() {
    let folder = tempfile::tempdir().unwrap();
    a_gone_node_is_forgotten(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_node_that_is_gone_can_be_forgotten_with_what_was_desired_of_it() {
    let server = Postgres::start();
    a_gone_node_is_forgotten(&server.url()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_web_page_of_another_site_changes_nothing_without_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let client = reqwest::Client::new();
    let body = json!({"u": 1e-4, "select": ["all"]}).to_string();
    for (path, method) in [
        ("/api/v1/rollouts", reqwest::Method::POST),
        ("/api/v1/rollouts/1/return", reqwest::Method::POST),
        ("/api/v1/trials/1/end", reqwest::Method::POST),
        ("/api/v1/threshold", reqwest::Method::PUT),
    ] {
        let ask = || {
            let request = client.request(method.clone(), format!("{}{path}", hub.http));
            request.body(body.clone())
        };
        let json = || ask().header("content-type", "application/json");
        let status =
            async |request: reqwest::RequestBuilder| request.send().await.unwrap().status();
        let page = json().header("origin", "http://evil.example");
        assert_eq!(status(page).await, StatusCode::FORBIDDEN, "{path}");
        let page = json().header("sec-fetch-site", "cross-site");
        assert_eq!(status(page).await, StatusCode::FORBIDDEN, "{path}");
        let form = ask().header("content-type", "text/plain");
        let expected = match method == reqwest::Method::POST {
            true => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            false => StatusCode::NOT_FOUND,
        };
        assert_eq!(status(form).await, expected, "{path}");
        // An own page and a client that is no browser get as far as the request itself.
        let own = json().header("origin", hub.http.clone());
        let expected = [StatusCode::NOT_FOUND, StatusCode::UNPROCESSABLE_ENTITY];
        assert!(expected.contains(&status(own).await), "{path}");
        assert!(expected.contains(&status(json()).await), "{path}");
    }
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn outcomes_are_told_as_they_come() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let played = Played::begin(&hub, fleet(4)).await;
    let request = reqwest::Client::new()
        .put(format!("{}/api/v1/threshold", hub.http))
        .header("accept", "application/x-ndjson")
        .json(&json!({"u": 2e-4, "select": ["all"], "wait_s": 60}));
    let response = request.send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "application/x-ndjson");
    let text = response.text().await.unwrap();
    let lines: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), 5, "{text}");
    assert!(
        lines[..4].iter().all(|line| line["outcome"] == "applied"),
        "{text}"
    );
    assert_eq!(lines[4]["counts"], json!({"applied": 4}));
    played.end().await;
    hub.stop().await;
}

/// Short stages, so that a rollout is walked in seconds.
fn rollout(u: f64) -> Value {
    json!({
        "u": u, "select": ["all"], "stages": ["1", "50%", "100%"], "soak_s": 4, "patience_s": 6, "baseline_s": 20,
        "gates": ["joules<=+10%", "skip_rate>=-0.2"], "fewest_clips": 5, "seed": 3,
    })
}

async fn ended(hub: &Hub, id: &Value) -> Value {
    hub.until(&format!("/api/v1/rollouts/{id}"), |rollout| {
        ["done", "returned", "held", "stopped"].contains(&rollout["phase"].as_str().unwrap_or(""))
    })
    .await
}

/// Waits until every node has told some clips, so that there is something to compare with.
async fn have_clips(hub: &Hub, nodes: usize, clips: u64) {
    hub.until("/api/v1/energy?by=node", |energy| {
        let groups = energy["groups"]
            .as_array()
            .map(Vec::as_slice)
            .unwrap_or_default();
        groups.len() >= nodes
            && groups
                .iter()
                .all(|group| group["clips"].as_u64() >= Some(clips))
    })
    .await;
}

async fn harm_is_undone(database: &str) {
    let hub = Hub::start(config(database)).await;
    let behaviour = Behaviour {
        spoilt_above: Some(4e-4),
        spoilt_by: 1.6,
        measured: true,
    };
    let played = Played::begin(
        &hub,
        Options {
            behaviour,
            ..fleet(20)
        },
    )
    .await;
    have_clips(&hub, 20, 15).await;
    let (status, begun) = post(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
    assert_eq!(status, StatusCode::CREATED, "{begun}");
    // A node of a rollout is not turned by another hand.
    let (_, answer) = put(&hub, json!({"u": 1e-4, "select": ["sim-000002"]})).await;
    assert_eq!(answer["counts"], json!({"refused": 1}), "{answer}");
    let returned = ended(&hub, &begun["id"]).await;
    assert_eq!(returned["phase"], "returned", "{returned}");
    let record = returned["record"].as_array().unwrap();
    let judged = record
        .iter()
        .rfind(|entry| entry["what"] == "judged")
        .unwrap();
    let gate = judged["gates"]
        .as_array()
        .unwrap()
        .iter()
        .find(|gate| gate["verdict"] == "failed")
        .unwrap();
    assert_eq!(
        (&gate["gate"], &gate["figure"]),
        (&json!("joules<=+10%"), &json!("joules_measured"))
    );
    assert!(gate["change"]["lower"].as_f64().unwrap() > 0.1, "{gate}");
    assert_eq!(
        (&gate["nodes"], &gate["compared"]),
        (&json!(9), &json!(10)),
        "{gate}"
    );
    hub.until("/api/v1/nodes?limit=1000", |nodes| {
        values(nodes) == [3e-4; 20]
    })
    .await;
    // The first node took the value and stayed alive; nine more showed its price, and all ten got the old value back.
    let changes = hub.get("/api/v1/changes").await;
    let origins: Vec<&Value> = changes["changes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| &c["origin"])
        .collect();
    let name = format!("rollout {}", begun["id"]);
    assert_eq!(origins, [&json!(name); 3], "{changes}");
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_that_does_harm_gives_the_old_value_back_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    harm_is_undone(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_rollout_that_does_harm_gives_the_old_value_back_by_itself() {
    let server = Postgres::start();
    harm_is_undone(&server.url()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_goes_on_where_it_was_when_the_hub_starts_anew_and_reaches_all_nodes() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let played = Played::begin(&hub, fleet(6)).await;
    have_clips(&hub, 6, 15).await;
    let (_, begun) = post(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
    let path = format!("/api/v1/rollouts/{}", begun["id"]);
    hub.until(&path, |rollout| rollout["phase"] == "soaking")
        .await;
    let again = hub.config.clone();
    hub.stop().await;
    let hub = Hub::start(again).await;
    let done = ended(&hub, &begun["id"]).await;
    assert_eq!(done["phase"], "done", "{done}");
    let whats = done["record"]
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| entry["what"].as_str().unwrap());
    assert_eq!(whats.filter(|what| *what == "stage").count(), 3);
    assert_eq!(values(&hub.get("/api/v1/nodes").await), [5e-4; 6]);
    // Also after its end the old values can be had back.
    let (status, answer) = post(&hub, &format!("{path}/return"), json!({})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    assert_eq!(ended(&hub, &begun["id"]).await["phase"], "returned");
    hub.until("/api/v1/nodes", |nodes| values(nodes) == [3e-4; 6])
        .await;
    let (status, answer) = post(&hub, &format!("{path}/pause"), json!({})).await;
    assert_eq!(status, StatusCode::CONFLICT, "{answer}");
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_that_is_stopped_has_ended_and_its_old_values_can_still_be_had_back() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let played = Played::begin(&hub, fleet(3)).await;
    let plan = json!({"u": 5e-4, "select": ["all"], "stages": ["100%"], "soak_s": 3600, "seed": 3});
    let (_, begun) = post(&hub, "/api/v1/rollouts", plan).await;
    let path = format!("/api/v1/rollouts/{}", begun["id"]);
    hub.until(&path, |rollout| rollout["phase"] == "soaking")
        .await;
    let (status, answer) = post(&hub, &format!("{path}/stop"), json!({})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let stopped = hub.get(&path).await;
    assert_eq!(stopped["phase"], "stopped");
    assert!(stopped["ended_ms"].is_i64(), "{stopped}");
    assert_eq!(values(&hub.get("/api/v1/nodes").await), [5e-4; 3]);
    let (status, answer) = post(&hub, &format!("{path}/return"), json!({})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    hub.until("/api/v1/nodes", |nodes| values(nodes) == [3e-4; 3])
        .await;
    played.end().await;
    hub.stop().await;
}

/// The commands that the docs print name rollout 1 and trial 1 of a new hub.
async fn each_counts_from_one(database: &str) {
    let hub = Hub::start(config(database)).await;
    let played = Played::begin(&hub, fleet(16)).await;
    let plan = json!({"values": [{"u": 1e-5}, {"u": 1e-2}], "select": ["all"], "duration_s": 600});
    let (_, trial) = post(&hub, "/api/v1/trials", plan).await;
    assert_eq!(trial["id"], 1, "{trial}");
    let (status, answer) = post(&hub, "/api/v1/trials/1/end", json!({})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    hub.until("/api/v1/trials/1", |trial| trial["phase"] == "done")
        .await;
    for id in 1..=2 {
        let (_, begun) = post(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
        assert_eq!(begun["id"], id, "{begun}");
        let (status, _) = post(&hub, &format!("/api/v1/rollouts/{id}/stop"), json!({})).await;
        assert_eq!(status, StatusCode::OK);
    }
    let list = hub.get("/api/v1/rollouts").await;
    assert_eq!(
        (&list["rollouts"][0]["id"], &list["rollouts"][1]["id"]),
        (&json!(2), &json!(1))
    );
    assert_eq!(hub.get("/api/v1/trials/1").await["phase"], "done");
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rollouts_and_trials_are_each_counted_from_one() {
    let folder = tempfile::tempdir().unwrap();
    each_counts_from_one(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_rollouts_and_trials_are_each_counted_from_one() {
    let server = Postgres::start();
    each_counts_from_one(&server.url()).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_node_in_a_rollout_of_one_hub_is_changed_by_no_other_hub() {
    let server = Postgres::start();
    let one = Hub::start(config(&server.url())).await;
    let mut beside = config(&server.url());
    beside.zenoh.connect = vec![one.zenoh.clone()];
    let two = Hub::start(beside).await;
    let played = Played::begin(&one, fleet(4)).await;
    two.until("/api/v1/nodes", |nodes| {
        let nodes = nodes["nodes"].as_array().into_iter().flatten();
        let online = nodes.filter(|node| node["state"] == "online");
        online.count() == 4
    })
    .await;
    let plan = json!({"u": 5e-4, "select": ["all"], "stages": ["1", "100%"], "soak_s": 600});
    let (status, begun) = post(&one, "/api/v1/rollouts", plan.clone()).await;
    assert_eq!(status, StatusCode::CREATED, "{begun}");
    let path = format!("/api/v1/rollouts/{}", begun["id"]);

    let by_hand = json!({"u": 1e-4, "select": ["all"], "wait_s": 8});
    let (_, answer) = put(&two, by_hand.clone()).await;
    assert_eq!(answer["counts"], json!({"refused": 4}), "{answer}");
    let (status, _) = post(&two, "/api/v1/rollouts", plan).await;
    assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY);
    let (status, answer) = post(&two, &format!("{path}/pause"), json!({})).await;
    assert_eq!(status, StatusCode::CONFLICT, "{answer}");

    let (status, _) = post(&one, &format!("{path}/stop"), json!({})).await;
    assert_eq!(status, StatusCode::OK);
    let (_, answer) = put(&two, by_hand).await;
    assert_eq!(answer["counts"], json!({"applied": 4}), "{answer}");
    played.end().await;
    for hub in [one, two] {
        let metrics = reqwest::get(format!("{}/metrics", hub.http)).await.unwrap();
        let metrics = metrics.text().await.unwrap();
        assert!(metrics.contains("albireo_hub_database_errors_total 0"));
        hub.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trial_measures_each_value_on_its_group_and_gives_the_old_value_back() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let played = Played::begin(&hub, fleet(16)).await;
    have_clips(&hub, 16, 15).await;
    let plan = json!({"values": [{"u": 1e-5}, {"u": 1e-2}], "select": ["all"], "duration_s": 5, "seed": 1});
    let (status, begun) = post(&hub, "/api/v1/trials", plan).await;
    assert_eq!(status, StatusCode::CREATED, "{begun}");
    let path = format!("/api/v1/trials/{}", begun["id"]);
    let done = hub.until(&path, |trial| trial["phase"] == "done").await;
    let arms = done["result"]["values"].as_array().unwrap();
    let joules = |arm: &Value| {
        let figures = arm["figures"].as_array().unwrap();
        figures
            .iter()
            .find(|figure| figure["figure"] == "joules_estimated")
            .unwrap()
            .clone()
    };
    assert_eq!(
        (&arms[0]["applied"], &arms[1]["applied"]),
        (&json!(8), &json!(8))
    );
    // Three decades of u are most of the frames: the difference is far above any noise.
    let difference = &joules(&arms[1])["difference"];
    assert!(difference["upper"].as_f64().unwrap() < 0.0, "{done}");
    hub.until("/api/v1/nodes?limit=1000", |nodes| {
        values(nodes) == [3e-4; 16]
    })
    .await;
    played.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_may_read_cannot_tune_and_the_history_names_who_did() {
    let folder = tempfile::tempdir().unwrap();
    let token = |name: &str, role, secret: &str| NamedToken {
        name: name.to_owned(),
        role,
        token: Some(Token::new(secret)),
        token_file: None,
    };
    let hub = Hub::start(HubConfig {
        tokens: vec![
            token("screen", Role::Read, "look"),
            token("night shift", Role::Tune, "turn"),
        ],
        ..config(&sqlite(folder.path()))
    })
    .await;
    let client = reqwest::Client::new();
    let ask = |method: reqwest::Method, path: &str, secret: &str| {
        client
            .request(method, format!("{}{path}", hub.http))
            .bearer_auth(secret)
    };
    let body = json!({"u": 1e-4, "select": ["all"]});
    for (path, method) in [
        ("/api/v1/threshold", reqwest::Method::PUT),
        ("/api/v1/target", reqwest::Method::PUT),
        ("/api/v1/rollouts", reqwest::Method::POST),
        ("/api/v1/rollouts/1/next", reqwest::Method::POST),
        ("/api/v1/trials", reqwest::Method::POST),
    ] {
        let response = ask(method, path, "look").json(&body).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::FORBIDDEN, "{path}");
        assert_eq!(
            response.headers()["content-type"],
            "application/problem+json"
        );
    }
    let response = ask(reqwest::Method::GET, "/api/v1/changes", "look")
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    // Nobody is there to be tuned; the request itself is allowed.
    let response = ask(reqwest::Method::PUT, "/api/v1/threshold", "turn")
        .json(&body)
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), StatusCode::NOT_FOUND);
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_makes_no_sense_is_refused_with_what_would_do() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    for (path, body, expected) in [
        (
            "/api/v1/rollouts",
            json!({"u": 1e-4, "select": ["all"], "stages": ["0%"]}),
            "stages",
        ),
        (
            "/api/v1/rollouts",
            json!({"u": 1e-4, "select": ["all"], "gates": ["joules>=5%"]}),
            "joules",
        ),
        (
            "/api/v1/rollouts",
            json!({"u": 1e-4, "select": ["all"], "soke_s": 5}),
            "soke_s",
        ),
        ("/api/v1/rollouts", json!({"select": ["all"]}), "threshold"),
        (
            "/api/v1/rollouts",
            json!({"u": 1e-4, "select": ["all"]}),
            "select: no selected node",
        ),
        ("/api/v1/trials", json!({"values": [{"u": 1e-4}]}), "values"),
    ] {
        let (status, answer) = post(&hub, path, body).await;
        assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY, "{answer}");
        assert!(
            answer["detail"].as_str().unwrap().contains(expected),
            "{expected}: {answer}"
        );
    }
    let (status, _) = post(&hub, "/api/v1/rollouts/77/next", json!({})).await;
    assert_eq!(status, StatusCode::NOT_FOUND);
    let (status, answer) = post(&hub, "/api/v1/rollouts/77/hurry", json!({})).await;
    assert_eq!(
        (status, answer["allowed"].as_array().unwrap().len()),
        (StatusCode::NOT_FOUND, 5)
    );
    let openapi = hub.get("/openapi.json").await;
    for path in [
        "/api/v1/threshold",
        "/api/v1/target",
        "/api/v1/rollouts/{id}",
        "/api/v1/trials",
        "/api/v1/changes/{revision}",
    ] {
        assert!(openapi["paths"][path].is_object(), "{path}");
    }
    hub.stop().await;
}
