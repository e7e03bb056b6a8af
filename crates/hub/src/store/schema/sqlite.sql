-- The tables of a hub in SQLite.
-- No figure is a floating-point number where it is summed: energy is whole microjoules, time whole microseconds,
-- so that a sum is the same in any order. docs/fleet.md lists the tables.

-- The program and the version of these tables.
CREATE TABLE hub_meta (key TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL);
INSERT INTO hub_meta (key, value) VALUES ('program', 'albireo-hub'), ('version', '17');

CREATE TABLE nodes (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    name TEXT NOT NULL UNIQUE,
    state TEXT NOT NULL,
    since_ms BIGINT NOT NULL,
    why TEXT NOT NULL,
    heard_ms BIGINT,
    revision BIGINT NOT NULL DEFAULT 0,
    status TEXT
);

-- The reports of a node: how many were stored, and which of its running counts never came. Counts are told from `base` on;
-- `ranges` is a JSON array of them; one below `base` is asked for, but nobody knows whether those reports exist.
-- `displaced` is the first and the last count of older ranges, which are no longer kept.
CREATE TABLE report_counts (
    node_id BIGINT NOT NULL PRIMARY KEY REFERENCES nodes (id),
    first_ms BIGINT NOT NULL,
    last_ms BIGINT NOT NULL,
    stored BIGINT NOT NULL DEFAULT 0,
    set_aside BIGINT NOT NULL DEFAULT 0,
    refused BIGINT NOT NULL DEFAULT 0,
    resets BIGINT NOT NULL DEFAULT 0,
    base BIGINT NOT NULL DEFAULT 0,
    highest BIGINT NOT NULL DEFAULT 0,
    missing BIGINT NOT NULL DEFAULT 0,
    ranges TEXT NOT NULL DEFAULT '[]',
    displaced TEXT NOT NULL DEFAULT '[0,0]'
) WITHOUT ROWID;

-- The identity of each report that came, for as long as a node may send it again. `day` is the day of the identity's own
-- time; where that cannot be believed it is the day of receipt, negative.
CREATE TABLE report_ids (
    day BIGINT NOT NULL,
    id BLOB NOT NULL,
    PRIMARY KEY (day, id)
) WITHOUT ROWID;
CREATE INDEX undated_report_ids ON report_ids (id) WHERE day < 0;

CREATE TABLE cameras (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    node_id BIGINT NOT NULL REFERENCES nodes (id),
    name TEXT NOT NULL,
    UNIQUE (node_id, name)
);

CREATE TABLE setups (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    policy TEXT NOT NULL,
    threshold TEXT NOT NULL,
    value TEXT NOT NULL,
    model TEXT NOT NULL,
    provider TEXT NOT NULL,
    power_source TEXT NOT NULL,
    total_from TEXT NOT NULL,
    UNIQUE (policy, threshold, value, model, provider, power_source, total_from)
);

-- A clip, or a part of a long one. `day` is that of the report's identity, or that of receipt where the identity's cannot be
-- believed. `travel` is JSON: the box and the track, if the node knows its position.
CREATE TABLE clips (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    day BIGINT NOT NULL,
    report_id BLOB NOT NULL,
    count BIGINT,
    camera_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    at_ms BIGINT NOT NULL,
    received_ms BIGINT NOT NULL,
    clip TEXT NOT NULL,
    part BIGINT NOT NULL,
    ended_by TEXT NOT NULL,
    duration_us BIGINT NOT NULL,
    frames BIGINT NOT NULL,
    frames_e BIGINT NOT NULL,
    frames_p BIGINT NOT NULL,
    frames_ei BIGINT NOT NULL,
    frames_i BIGINT NOT NULL,
    frames_ai BIGINT NOT NULL,
    degraded BIGINT NOT NULL,
    dropped BIGINT NOT NULL,
    latency_mean_us BIGINT NOT NULL,
    latency_p99_us BIGINT NOT NULL,
    latency_us BIGINT NOT NULL,
    detector_calls BIGINT NOT NULL,
    detector_mean_us BIGINT NOT NULL,
    detector_us BIGINT NOT NULL,
    avoided_calls BIGINT NOT NULL,
    avoided_uj BIGINT,
    quality SMALLINT NOT NULL,
    energy_uj BIGINT,
    node_uj BIGINT,
    edp DOUBLE PRECISION,
    coverage_ppm BIGINT NOT NULL,
    threshold_changed BIGINT NOT NULL,
    audit_frames BIGINT,
    audit_missed BIGINT,
    audit_missed_boxes BIGINT,
    audit_calls BIGINT,
    audit_us BIGINT,
    audit_uj BIGINT,
    audit_detected BIGINT,
    audit_shown BIGINT,
    audit_paired BIGINT,
    audit_detected_sq BIGINT,
    audit_detected_x BIGINT,
    audit_shown_sq BIGINT,
    audit_paired_sq BIGINT,
    audit_shown_x BIGINT,
    distance_mm BIGINT,
    travel TEXT
);
CREATE INDEX clips_by_camera ON clips (camera_id, at_ms);
CREATE INDEX clips_with_positions ON clips (at_ms) WHERE distance_mm IS NOT NULL;

-- Sums over the clips of one camera, setup and energy quality that began within five minutes. Under camera 0 are those of the
-- whole fleet, so that its figures read a few rows. `travel_mm` and `travel_uj` are the distance and the node's energy of the
-- clips of which both are known in full.
CREATE TABLE sums_5m (
    bucket_s BIGINT NOT NULL,
    camera_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    quality SMALLINT NOT NULL,
    clips BIGINT NOT NULL,
    duration_us BIGINT NOT NULL,
    frames BIGINT NOT NULL,
    frames_e BIGINT NOT NULL,
    frames_p BIGINT NOT NULL,
    frames_ei BIGINT NOT NULL,
    frames_i BIGINT NOT NULL,
    frames_ai BIGINT NOT NULL,
    degraded BIGINT NOT NULL,
    dropped BIGINT NOT NULL,
    latency_us BIGINT NOT NULL,
    detector_calls BIGINT NOT NULL,
    detector_us BIGINT NOT NULL,
    avoided_calls BIGINT NOT NULL,
    unpriced_calls BIGINT NOT NULL,
    avoided_uj BIGINT NOT NULL,
    energy_uj BIGINT NOT NULL,
    audit_frames BIGINT NOT NULL,
    audit_missed BIGINT NOT NULL,
    audit_missed_boxes BIGINT NOT NULL,
    audit_calls BIGINT NOT NULL,
    audit_us BIGINT NOT NULL,
    audit_uj BIGINT NOT NULL,
    audit_detected BIGINT NOT NULL,
    audit_shown BIGINT NOT NULL,
    audit_paired BIGINT NOT NULL,
    audit_detected_sq BIGINT NOT NULL,
    audit_detected_x BIGINT NOT NULL,
    audit_shown_sq BIGINT NOT NULL,
    audit_paired_sq BIGINT NOT NULL,
    audit_shown_x BIGINT NOT NULL,
    travel_mm BIGINT NOT NULL DEFAULT 0,
    travel_uj BIGINT NOT NULL DEFAULT 0,
    PRIMARY KEY (camera_id, bucket_s, setup_id, quality)
) WITHOUT ROWID;

-- The same over an hour.
CREATE TABLE sums_hour (
    bucket_s BIGINT NOT NULL,
    camera_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    quality SMALLINT NOT NULL,
    clips BIGINT NOT NULL,
    duration_us BIGINT NOT NULL,
    frames BIGINT NOT NULL,
    frames_e BIGINT NOT NULL,
    frames_p BIGINT NOT NULL,
    frames_ei BIGINT NOT NULL,
    frames_i BIGINT NOT NULL,
    frames_ai BIGINT NOT NULL,
    degraded BIGINT NOT NULL,
    dropped BIGINT NOT NULL,
    latency_us BIGINT NOT NULL,
    detector_calls BIGINT NOT NULL,
    detector_us BIGINT NOT NULL,
    avoided_calls BIGINT NOT NULL,
    unpriced_calls BIGINT NOT NULL,
    avoided_uj BIGINT NOT NULL,
    energy_uj BIGINT NOT NULL,
    audit_frames BIGINT NOT NULL,
    audit_missed BIGINT NOT NULL,
    audit_missed_boxes BIGINT NOT NULL,
    audit_calls BIGINT NOT NULL,
    audit_us BIGINT NOT NULL,
    audit_uj BIGINT NOT NULL,
    audit_detected BIGINT NOT NULL,
    audit_shown BIGINT NOT NULL,
    audit_paired BIGINT NOT NULL,
    audit_detected_sq BIGINT NOT NULL,
    audit_detected_x BIGINT NOT NULL,
    audit_shown_sq BIGINT NOT NULL,
    audit_paired_sq BIGINT NOT NULL,
    audit_shown_x BIGINT NOT NULL,
    travel_mm BIGINT NOT NULL DEFAULT 0,
    travel_uj BIGINT NOT NULL DEFAULT 0,
    PRIMARY KEY (camera_id, bucket_s, setup_id, quality)
) WITHOUT ROWID;

-- A report that makes no sense.
CREATE TABLE set_aside (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    node_id BIGINT NOT NULL,
    report_id TEXT,
    received_ms BIGINT NOT NULL,
    cause TEXT NOT NULL,
    body TEXT NOT NULL
);
CREATE INDEX set_aside_by_node ON set_aside (node_id, id);

CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at_ms BIGINT NOT NULL,
    kind TEXT NOT NULL,
    node TEXT,
    detail TEXT NOT NULL
);

-- What is desired of nodes, under which revision, what became of it; rollouts and trials. A setting is JSON, as in the API:
-- {"threshold": {"name": "u", "value": 0.0003}}, {"target": {"skip_rate": 0.5}}, or {"target": null} for no target.
CREATE TABLE counters (
    name TEXT NOT NULL PRIMARY KEY,
    value BIGINT NOT NULL
);
INSERT INTO counters (name, value) VALUES ('revision', 0), ('rollout', 0), ('trial', 0);

CREATE TABLE desired (
    node TEXT NOT NULL PRIMARY KEY,
    revision BIGINT NOT NULL,
    setting TEXT NOT NULL
);
CREATE INDEX desired_by_revision ON desired (revision);

CREATE TABLE revisions (
    revision BIGINT NOT NULL PRIMARY KEY,
    at_ms BIGINT NOT NULL,
    who TEXT NOT NULL,
    why TEXT NOT NULL,
    origin TEXT NOT NULL,
    selector TEXT NOT NULL,
    setting TEXT NOT NULL
);

-- `setting_before` is the setting that a node had, where that was known.
CREATE TABLE revision_nodes (
    revision BIGINT NOT NULL,
    node TEXT NOT NULL,
    setting_before TEXT,
    given_ms BIGINT NOT NULL,
    outcome TEXT NOT NULL,
    at_ms BIGINT NOT NULL,
    detail TEXT NOT NULL,
    PRIMARY KEY (revision, node)
) WITHOUT ROWID;
CREATE INDEX revision_nodes_by_node ON revision_nodes (node, revision);
CREATE INDEX revision_nodes_open ON revision_nodes (revision)
    WHERE outcome IN ('pending', 'waiting', 'timed_out');

-- Rollouts and trials, each counted from 1.
CREATE TABLE runs (
    kind TEXT NOT NULL,
    id BIGINT NOT NULL,
    ended_ms BIGINT,
    driver TEXT NOT NULL,
    driven_until_ms BIGINT NOT NULL,
    state TEXT NOT NULL,
    PRIMARY KEY (kind, id)
);
CREATE INDEX runs_open ON runs (kind, id) WHERE ended_ms IS NULL;
