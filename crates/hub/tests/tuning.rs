//! Values reach simulated nodes; rollouts advance, return and survive a restart; trials compare values.

use crate::support::postgres::Postgres;
use crate::support::{
    Hub, assert_contains, assert_has, config, full_status, names, number, on_both, sqlite,
};
use albireo_hub::config::{PresenceConfig, TuningConfig};
use albireo_hub::presence::Fleet;
use albireo_hub::store::Store;
use albireo_hub::tuning::run::{Command, Kind};
use albireo_hub::tuning::{DesiredSettings, Tuner};
use albireo_service::clock::Now;
use albireo_service::config::{NamedToken, Role, Token};
use albireo_simulate::Options;
use albireo_wire::Threshold;
use reqwest::{Method, Response, StatusCode};
use rstest::rstest;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

pub(crate) struct SimulatedFleet {
    stop: DropGuard,
    task: JoinHandle<Result<albireo_simulate::Summary, albireo_simulate::SimulateError>>,
}

/// Options of a few nodes that report often.
pub(crate) fn fleet(nodes: usize) -> Options {
    Options {
        nodes,
        sessions: 2.min(nodes),
        duration: Duration::from_secs(600),
        status_s: Some(0.5),
        clip_s: 0.2,
        gather: 1,
        drain: Duration::from_secs(10),
        seed: 1,
        ..Options::default()
    }
}

impl SimulatedFleet {
    pub(crate) async fn start(hub: &Hub, options: Options) -> Self {
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
        let stop = stop.drop_guard();
        Self { stop, task }
    }

    pub(crate) async fn end(self) {
        drop(self.stop);
        self.task.await.unwrap().unwrap();
    }
}

pub(crate) async fn put(hub: &Hub, body: Value, counts: Value) -> Value {
    put_at(hub, "/api/v1/threshold", body, counts).await
}

pub(crate) async fn put_at(hub: &Hub, path: &str, body: Value, counts: Value) -> Value {
    let answer = send(hub, Method::PUT, path, body, StatusCode::OK).await;
    assert_eq!(answer["counts"], counts, "{answer}");
    answer
}

pub(crate) async fn begin(hub: &Hub, path: &str, plan: Value) -> Value {
    send(hub, Method::POST, path, plan, StatusCode::CREATED).await
}

async fn command(hub: &Hub, path: &str, expected: StatusCode) -> Value {
    send(hub, Method::POST, path, json!({}), expected).await
}

/// The answer to a request, which must have this status.
pub(crate) async fn send(
    hub: &Hub,
    method: Method,
    path: &str,
    body: Value,
    expected: StatusCode,
) -> Value {
    let request = reqwest::Client::new().request(method, format!("{}{path}", hub.http));
    let response = request.json(&body).send().await.unwrap();
    let status = response.status();
    let answer = response.json().await.unwrap();
    assert_eq!(status, expected, "{path} {body}: {answer}");
    answer
}

/// A `u` for all nodes.
fn all(u: f64) -> Value {
    json!({"u": u, "select": ["all"]})
}

/// The threshold that each node reports.
pub(crate) fn values(nodes: &Value) -> Vec<f64> {
    nodes["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["status"]["cameras"][0]["threshold"]["value"].as_f64().unwrap())
        .collect()
}

async fn all_have(hub: &Hub, nodes: usize, u: f64) {
    let have = |page: &Value| values(page) == vec![u; nodes];
    hub.until("/api/v1/nodes?limit=1000", have).await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn nodes_with_old_revisions_obey_a_hub_with_an_empty_database_and_outcomes_are_streamed() {
    let hub = Hub::fresh().await;
    let simulated = SimulatedFleet::start(&hub, fleet(4)).await;
    let mut last = Value::Null;
    for u in [1e-4, 2e-4, 1e-4, 2e-4] {
        last = put(&hub, all(u), json!({"applied": 4})).await["revision"].clone();
    }
    let empty = tempfile::tempdir().unwrap();
    let mut again = hub.config.clone();
    hub.stop().await;
    again.database.url = sqlite(empty.path());
    let hub = Hub::start(again).await;
    let all_have_last =
        |nodes: &Vec<Value>| nodes.len() == 4 && nodes.iter().all(|node| node["revision"] == last);
    hub.until("/api/v1/nodes", |page| {
        page["nodes"].as_array().is_some_and(all_have_last)
    })
    .await;
    let answer = put(&hub, all(5e-4), json!({"applied": 4})).await;
    let revision = answer["revision"].as_u64().unwrap();
    assert!(revision > last.as_u64().unwrap(), "{answer}");

    // Each outcome is streamed.
    let response = reqwest::Client::new()
        .put(format!("{}/api/v1/threshold", hub.http))
        .header("accept", "application/x-ndjson")
        .json(&json!({"u": 2e-4, "select": ["all"], "wait_s": 60}))
        .send()
        .await
        .unwrap();
    assert_eq!(response.headers()["content-type"], "application/x-ndjson");
    let text = response.text().await.unwrap();
    let lines: Vec<Value> = text.lines().map(serde_json::from_str).map(Result::unwrap).collect();
    assert_eq!(lines.len(), 5, "{text}");
    assert!(
        lines[..4].iter().all(|line| line["outcome"] == "applied"),
        "{text}"
    );
    assert_eq!(lines[4]["counts"], json!({"applied": 4}));

    // A node that reports an impossible revision is named, and uses up no revisions.
    let liar = albireo_wire::StatusMessage {
        revision: 1 << 53,
        ..full_status(10, 1, &[])
    };
    hub.put_status("liar", &liar).await;
    hub.until("/api/v1/nodes", |page| page["total"] == 5).await;
    let answer = put(&hub, all(1e-4), json!({"applied": 4, "refused": 1})).await;
    assert!(answer["revision"].as_u64().unwrap() < revision + 1000);
    let liar = answer["nodes"].as_array().unwrap().iter().find(|line| line["node"] == "liar");
    assert_contains(&liar.unwrap()["detail"], &["revision 9007199254740992"]);
    simulated.end().await;
    hub.stop().await;
}

async fn an_offline_node_can_be_forgotten_with_its_desired_setting(database: &str) {
    let mut config = config(database);
    config.presence.silent_after_s = 2.0;
    config.presence.offline_after_s = 4.0;
    let hub = Hub::start(config).await;
    let simulated = SimulatedFleet::start(&hub, fleet(2)).await;
    put(&hub, all(1e-4), json!({"applied": 2})).await;
    let forget = async |hub: &Hub, node: &str| {
        let url = format!("{}/api/v1/nodes/{node}", hub.http);
        let answer = reqwest::Client::new().delete(url).send().await.unwrap();
        answer.status()
    };
    // A node that still reports would be back at once.
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::CONFLICT);
    simulated.end().await;
    hub.until("/api/v1/nodes", |nodes| {
        nodes["counts"]["online"] == 0 && nodes["counts"]["degraded"] == 0
    })
    .await;
    // A setting given while it is offline is dropped with it.
    let body = json!({"u": 5e-4, "select": ["sim-000001"], "wait_s": 0});
    let answer = send(&hub, Method::PUT, "/api/v1/threshold", body, StatusCode::OK).await;
    let change = answer["revision"].as_u64().unwrap();
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::NO_CONTENT);
    assert_eq!(forget(&hub, "sim-000001").await, StatusCode::NOT_FOUND);
    assert_eq!(names(&hub.get("/api/v1/nodes").await), ["sim-000000"]);
    hub.until(&format!("/api/v1/revisions/{change}"), |change| {
        change["nodes"][0]["outcome"] == "missed"
    })
    .await;

    // It stays forgotten after a restart, and is a new node without a desired setting when it comes back.
    let hub = hub.restart().await;
    assert_eq!(names(&hub.get("/api/v1/nodes").await), ["sim-000000"]);
    let simulated = SimulatedFleet::start(&hub, fleet(2)).await;
    hub.until("/api/v1/nodes", |nodes| values(nodes) == [1e-4, 3e-4]).await;
    simulated.end().await;
    hub.stop().await;
}

on_both!(an_offline_node_can_be_forgotten_with_its_desired_setting);

const JSON: (&str, &str) = ("content-type", "application/json");

/// The answer to a change of all nodes with these headers.
async fn ask(hub: &Hub, method: &Method, path: &str, headers: &[(&str, &str)]) -> Response {
    let mut request = reqwest::Client::new().request(method.clone(), format!("{}{path}", hub.http));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let body = all(1e-4).to_string();
    request.body(body).send().await.unwrap()
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_another_site_changes_nothing_without_a_token() {
    let hub = Hub::fresh().await;
    for (path, method, to_a_form) in [
        ("/api/v1/rollouts", Method::POST, 415),
        ("/api/v1/rollouts/1/return", Method::POST, 415),
        ("/api/v1/trials/1/end", Method::POST, 415),
        ("/api/v1/threshold", Method::PUT, 404),
    ] {
        for (headers, expected) in [
            (&[JSON, ("origin", "http://evil.example")][..], &[403][..]),
            (&[JSON, ("sec-fetch-site", "cross-site")], &[403]),
            (&[("content-type", "text/plain")], &[to_a_form]),
            // The hub's own page and a client other than a browser get as far as the request itself.
            (&[JSON, ("origin", &*hub.http)], &[404, 422]),
            (&[JSON], &[404, 422]),
        ] {
            let status = ask(&hub, &method, path, headers).await.status().as_u16();
            assert!(expected.contains(&status), "{path} {headers:?}: {status}");
        }
    }
    hub.stop().await;
}

/// A rollout in short stages, which takes seconds.
fn rollout(u: f64) -> Value {
    json!({
        "u": u, "select": ["all"], "stages": ["1", "50%", "100%"], "soak_s": 4, "patience_s": 6, "baseline_s": 20,
        "gates": ["joules<=+10%", "skip_rate>=-0.2"], "fewest_clips": 5, "seed": 3,
    })
}

async fn ended(hub: &Hub, path: &str) -> Value {
    hub.until(path, |rollout| {
        ["done", "returned", "held", "stopped"].contains(&rollout["phase"].as_str().unwrap_or(""))
    })
    .await
}

async fn have_clips(hub: &Hub, nodes: usize, clips: u64) {
    hub.until("/api/v1/energy?by=node", |energy| {
        energy["groups"].as_array().is_some_and(|groups| {
            groups.len() >= nodes
                && groups.iter().all(|group| group["clips"].as_u64() >= Some(clips))
        })
    })
    .await;
}

/// The commands that the docs print name rollout 1 and trial 1 of a new hub.
async fn a_harmful_rollout_and_a_trial_restore_the_old_value_and_are_each_numbered_from_one(
    database: &str,
) {
    let hub = Hub::start(config(database)).await;
    let options = Options {
        worse_above: Some(4e-4),
        worse_by: 1.6,
        measured: true,
        ..fleet(20)
    };
    let simulated = SimulatedFleet::start(&hub, options).await;
    have_clips(&hub, 20, 15).await;
    let begun = begin(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
    assert_eq!(begun["id"], 1, "{begun}");
    // A node in a rollout cannot be changed by another request.
    let other = json!({"u": 1e-4, "select": ["sim-000002"]});
    put(&hub, other, json!({"refused": 1})).await;
    let refused = StatusCode::UNPROCESSABLE_ENTITY;
    let second = send(
        &hub,
        Method::POST,
        "/api/v1/rollouts",
        rollout(1e-4),
        refused,
    )
    .await;
    assert_contains(&second["detail"], &["20 nodes (takes part in rollout 1)"]);
    let returned = ended(&hub, "/api/v1/rollouts/1").await;
    assert_eq!(returned["phase"], "returned", "{returned}");
    let judged = returned["record"]
        .as_array()
        .unwrap()
        .iter()
        .rfind(|entry| entry["what"] == "judged")
        .unwrap();
    let gate = judged["gates"]
        .as_array()
        .unwrap()
        .iter()
        .find(|gate| gate["verdict"] == "failed")
        .unwrap();
    let expected =
        json!({"gate": "joules<=+10%", "figure": "joules_measured", "nodes": 9, "compared": 10});
    assert_has(gate, &expected);
    assert!(gate["change"]["lower"].as_f64().unwrap() > 0.1, "{gate}");
    all_have(&hub, 20, 3e-4).await;
    // The first node took the value and kept reporting; nine more showed its cost, and all ten got the old value back.
    let revisions = hub.get("/api/v1/revisions").await;
    let origins: Vec<&Value> = revisions["revisions"]
        .as_array()
        .unwrap()
        .iter()
        .map(|change| &change["origin"])
        .collect();
    assert_eq!(origins, ["rollout 1"; 3], "{revisions}");

    // The first value changes so many frames that the difference is far above any noise.
    let trial_of = |values: Value, seconds: u64| {
        json!({
            "values": values, "select": ["all"], "duration_s": seconds, "seed": 1,
        })
    };
    let plan = trial_of(json!([{"u": 1e-5}, {"u": 3.5e-4}]), 5);
    let trial = begin(&hub, "/api/v1/trials", plan).await;
    assert_eq!(trial["id"], 1, "{trial}");
    let is_done = |trial: &Value| trial["phase"] == "done";
    let done = hub.until("/api/v1/trials/1", is_done).await;
    let arms = done["result"]["values"].as_array().unwrap();
    assert!(arms.iter().all(|arm| arm["applied"] == 10), "{done}");
    let joules = arms[1]["figures"]
        .as_array()
        .unwrap()
        .iter()
        .find(|one| one["figure"] == "joules_measured");
    let difference = &joules.unwrap()["difference"];
    assert!(difference["upper"].as_f64().unwrap() < 0.0, "{done}");
    all_have(&hub, 20, 3e-4).await;
    let plan = trial_of(json!([{"u": 1e-5}, {"u": 1e-2}]), 600);
    begin(&hub, "/api/v1/trials", plan).await;
    command(&hub, "/api/v1/trials/2/end", StatusCode::OK).await;
    hub.until("/api/v1/trials/2", is_done).await;
    let begun = begin(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
    assert_eq!(begun["id"], 2, "{begun}");
    command(&hub, "/api/v1/rollouts/2/stop", StatusCode::OK).await;
    let stopped = hub.get("/api/v1/rollouts/2").await;
    assert_eq!(stopped["phase"], "stopped");
    assert!(stopped["ended_ms"].is_i64(), "{stopped}");
    let list = hub.get("/api/v1/rollouts").await;
    assert_has(&list, &json!({"runs": [{"id": 2}, {"id": 1}]}));
    assert_eq!(hub.get("/api/v1/trials/1").await["phase"], "done");
    simulated.end().await;
    hub.stop().await;
}

on_both!(a_harmful_rollout_and_a_trial_restore_the_old_value_and_are_each_numbered_from_one);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_resumes_after_a_hub_restart_and_reaches_all_nodes() {
    let hub = Hub::fresh().await;
    let simulated = SimulatedFleet::start(&hub, fleet(6)).await;
    have_clips(&hub, 6, 15).await;
    let begun = begin(&hub, "/api/v1/rollouts", rollout(5e-4)).await;
    let path = format!("/api/v1/rollouts/{}", begun["id"]);
    hub.until(&path, |run| run["phase"] == "soaking").await;
    let hub = hub.restart().await;
    let done = ended(&hub, &path).await;
    assert_eq!(done["phase"], "done", "{done}");
    let record = done["record"].as_array().unwrap();
    let stages = record.iter().filter(|entry| entry["what"] == "stage");
    assert_eq!(stages.count(), 3);
    assert_eq!(values(&hub.get("/api/v1/nodes").await), [5e-4; 6]);
    // The old values can be restored even after its end.
    command(&hub, &format!("{path}/return"), StatusCode::OK).await;
    assert_eq!(ended(&hub, &path).await["phase"], "returned");
    all_have(&hub, 6, 3e-4).await;
    command(&hub, &format!("{path}/pause"), StatusCode::CONFLICT).await;
    simulated.end().await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_node_in_a_rollout_of_one_hub_is_changed_by_no_other_hub() {
    let server = Postgres::start();
    let one = Hub::start(config(&server.url())).await;
    let mut beside = config(&server.url());
    beside.zenoh.connect = vec![one.zenoh.clone()];
    let two = Hub::start(beside).await;
    let simulated = SimulatedFleet::start(&one, fleet(4)).await;
    two.until("/api/v1/nodes", |page| page["counts"]["online"] == 4).await;
    let plan = json!({"u": 5e-4, "select": ["all"], "stages": ["1", "100%"], "soak_s": 600});
    let begun = begin(&one, "/api/v1/rollouts", plan.clone()).await;
    let path = format!("/api/v1/rollouts/{}", begun["id"]);

    let by_hand = json!({"u": 1e-4, "select": ["all"], "wait_s": 8});
    put(&two, by_hand.clone(), json!({"refused": 4})).await;
    let refused = StatusCode::UNPROCESSABLE_ENTITY;
    send(&two, Method::POST, "/api/v1/rollouts", plan, refused).await;
    command(&two, &format!("{path}/pause"), StatusCode::CONFLICT).await;

    command(&one, &format!("{path}/stop"), StatusCode::OK).await;
    put(&two, by_hand, json!({"applied": 4})).await;
    simulated.end().await;
    for hub in [one, two] {
        hub.assert_metrics(&["albireo_hub_database_errors_total 0"]).await;
        hub.stop().await;
    }
}

/// The tuner of one of several hubs on a database, which all know this node.
async fn tuner(store: &Store, driver: &str) -> Tuner {
    let fleet = Fleet::new(&PresenceConfig::default());
    let mut status = full_status(10, 0, &[]);
    let camera = json!({
        "name": "front", "state": "live", "threshold": {"name": "u", "value": 3e-4}, "threshold_source": "hub",
    });
    let cameras = serde_json::from_value(json!([camera])).unwrap();
    status.full.as_mut().unwrap().cameras = cameras;
    fleet.apply_status("car-1", status, Now::system());
    let (desired, _notices) = DesiredSettings::new();
    let tuner = Tuner::open(
        store.clone(),
        Arc::new(fleet),
        Arc::new(desired),
        TuningConfig::default(),
        driver.to_owned(),
    );
    tuner.await.unwrap()
}

async fn a_hub_that_lost_its_claim_to_another_is_told_so_and_changes_nothing(database: &str) {
    let store = Store::open(&config(database).database).await.unwrap();
    let one = tuner(&store, "one").await;
    let two = tuner(&store, "two").await;
    let mut now = Now::system().unix_ms;
    // Before the other hub has ended the rollout, and after that.
    for has_ended in [false, true] {
        let kind = Kind::Rollout {
            to: Threshold::new("u", 5e-4),
            plan: serde_json::from_value(json!({"stages": ["all"]})).unwrap(),
        };
        let id = one.begin(kind, "ops", now).await.unwrap().id;
        // The first hub stands still for longer than its claim lasts.
        now += 30_000;
        two.drive(now).await.unwrap();
        if has_ended {
            two.command("rollout", id, Command::Stop, "ops", now).await.unwrap();
        }
        for command in [Command::Pause, Command::Stop] {
            let refused = one.command("rollout", id, command, "ops", now).await;
            let problem = serde_json::to_value(refused.unwrap_err()).unwrap();
            assert_eq!(problem["status"], 409, "{problem}");
            assert_contains(&problem["detail"], &["driven by another hub"]);
        }
        if !has_ended {
            two.command("rollout", id, Command::Stop, "ops", now).await.unwrap();
        }
        now += 30_000;
    }
    // What has ended has not begun again.
    let open = number(database, "SELECT count(*) FROM runs WHERE ended_ms IS NULL");
    assert_eq!(open.await, 0);
}

on_both!(a_hub_that_lost_its_claim_to_another_is_told_so_and_changes_nothing);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_read_token_cannot_tune_and_a_tune_token_can() {
    let token = |role, secret: &str| NamedToken {
        role,
        token: Some(Token::new(secret)),
        ..NamedToken::default()
    };
    let tokens = vec![token(Role::Read, "look"), token(Role::Tune, "turn")];
    let hub = Hub::fresh_with(|config| config.tokens = tokens).await;
    let look = ("authorization", "Bearer look");
    let turn = ("authorization", "Bearer turn");
    for (path, method) in [
        ("/api/v1/threshold", Method::PUT),
        ("/api/v1/target", Method::PUT),
        ("/api/v1/rollouts", Method::POST),
        ("/api/v1/rollouts/1/next", Method::POST),
        ("/api/v1/trials", Method::POST),
    ] {
        let response = ask(&hub, &method, path, &[JSON, look]).await;
        assert_eq!(response.status(), StatusCode::FORBIDDEN, "{path}");
        let media_type = &response.headers()["content-type"];
        assert_eq!(media_type, "application/problem+json");
    }
    let read = ask(&hub, &Method::GET, "/api/v1/revisions", &[look]).await;
    assert_eq!(read.status(), StatusCode::OK);
    // There is no node to tune; the request itself is allowed.
    let change = ask(&hub, &Method::PUT, "/api/v1/threshold", &[JSON, turn]).await;
    assert_eq!(change.status(), StatusCode::NOT_FOUND);
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_request_is_rejected_with_a_remedy() {
    let hub = Hub::fresh().await;
    // The end of the path, the body, and a part of the answer.
    for case in [
        r#"rollouts {"u": 1e-4, "select": ["all"], "stages": ["0%"]} -> stages"#,
        r#"rollouts {"u": 1e-4, "select": ["all"], "gates": ["joules>=5%"]} -> joules"#,
        r#"rollouts {"u": 1e-4, "select": ["all"], "soke_s": 5} -> soke_s"#,
        r#"rollouts {"select": ["all"]} -> threshold"#,
        r#"rollouts {"u": 1e-4, "select": ["all"]} -> select: no node is selected"#,
        r#"trials {"values": [{"u": 1e-4}]} -> values"#,
        r#"target {"select": ["all"]} -> must have a target"#,
        r#"target {"target": 0.5, "select": ["all"]} -> target: "#,
        r#"target {"target": {"speed": 3}, "select": ["all"]} -> unknown variant `speed`"#,
        r#"target {"target": {"skip_rate": 1.5}, "select": ["all"]} -> from 0.01 to 0.99"#,
        r#"target {"target": {"skip_rate": 0.5}} -> select"#,
        r#"target {"target": null, "select": ["all"], "u": 3e-4} -> unknown field `u`"#,
    ] {
        let (request, expected) = case.split_once(" -> ").unwrap();
        let (path, body) = request.split_once(' ').unwrap();
        let method = match path {
            "target" => Method::PUT,
            _ => Method::POST,
        };
        let body = serde_json::from_str(body).unwrap();
        let path = format!("/api/v1/{path}");
        let refused = StatusCode::UNPROCESSABLE_ENTITY;
        let answer = send(&hub, method, &path, body, refused).await;
        assert!(
            answer["detail"].to_string().contains(expected),
            "{case}: {answer}"
        );
        if expected.contains("target") {
            assert_eq!(answer["allowed"][1], "skip_rate", "{answer}");
        }
    }
    command(&hub, "/api/v1/rollouts/77/next", StatusCode::NOT_FOUND).await;
    let answer = command(&hub, "/api/v1/rollouts/77/hurry", StatusCode::NOT_FOUND).await;
    assert_eq!(answer["allowed"].as_array().unwrap().len(), 5);
    hub.stop().await;
}
