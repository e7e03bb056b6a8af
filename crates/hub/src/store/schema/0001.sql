-- {ID}: a number given by the database. {CLUSTERED}: rows lie in the order of the primary key (SQLite only).
-- No figure is a floating-point number where it is summed: energy is whole microjoules, time whole microseconds,
-- so that a sum is the same in any order. docs/hub-schema.md describes every column.

CREATE TABLE nodes (
    id {ID},
    name TEXT NOT NULL UNIQUE,
    first_seen_ms BIGINT NOT NULL,
    state TEXT NOT NULL,
    since_ms BIGINT NOT NULL,
    why TEXT NOT NULL,
    heard_ms BIGINT,
    instance TEXT,
    machine TEXT,
    started_ns BIGINT,
    revision BIGINT NOT NULL DEFAULT 0,
    status TEXT
);

CREATE TABLE instances (
    id {ID},
    node_id BIGINT NOT NULL REFERENCES nodes (id),
    instance TEXT NOT NULL,
    machine TEXT,
    next_report BIGINT NOT NULL,
    first_ms BIGINT NOT NULL,
    last_ms BIGINT NOT NULL,
    latest_started_ns BIGINT NOT NULL,
    reports BIGINT NOT NULL,
    set_aside BIGINT NOT NULL,
    missing BIGINT NOT NULL,
    lost BIGINT NOT NULL,
    conflicts BIGINT NOT NULL,
    UNIQUE (node_id, instance)
);

CREATE TABLE cameras (
    id {ID},
    node_id BIGINT NOT NULL REFERENCES nodes (id),
    name TEXT NOT NULL,
    UNIQUE (node_id, name)
);

CREATE TABLE setups (
    id {ID},
    policy TEXT NOT NULL,
    knob TEXT NOT NULL,
    value TEXT NOT NULL,
    model TEXT NOT NULL,
    provider TEXT NOT NULL,
    power_source TEXT NOT NULL,
    total_from TEXT NOT NULL,
    UNIQUE (policy, knob, value, model, provider, power_source, total_from)
);

CREATE TABLE clips (
    id {ID},
    camera_id BIGINT NOT NULL,
    instance_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    report BIGINT NOT NULL,
    at_ms BIGINT NOT NULL,
    received_ms BIGINT NOT NULL,
    started_ns BIGINT NOT NULL,
    clip TEXT NOT NULL,
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
    latency_p50_us BIGINT NOT NULL,
    latency_p95_us BIGINT NOT NULL,
    latency_p99_us BIGINT NOT NULL,
    latency_us BIGINT NOT NULL,
    detector_calls BIGINT NOT NULL,
    detector_mean_us BIGINT NOT NULL,
    detector_p50_us BIGINT NOT NULL,
    detector_p95_us BIGINT NOT NULL,
    detector_p99_us BIGINT NOT NULL,
    detector_us BIGINT NOT NULL,
    avoided_calls BIGINT NOT NULL,
    avoided_uj BIGINT,
    quality SMALLINT NOT NULL,
    energy_uj BIGINT,
    node_uj BIGINT,
    gpu_uj BIGINT,
    cpu_uj BIGINT,
    io_mem_uj BIGINT,
    edp DOUBLE PRECISION,
    samples BIGINT NOT NULL,
    coverage_ppm BIGINT NOT NULL,
    details TEXT
);
CREATE UNIQUE INDEX clips_by_report ON clips (instance_id, report);
CREATE INDEX clips_by_camera ON clips (camera_id, at_ms);

CREATE TABLE sums_5m (
    bucket_s BIGINT NOT NULL,
    camera_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    quality SMALLINT NOT NULL,
    {SUMS},
    PRIMARY KEY (bucket_s, camera_id, setup_id, quality)
) {CLUSTERED};

CREATE TABLE sums_day (
    bucket_s BIGINT NOT NULL,
    camera_id BIGINT NOT NULL,
    setup_id BIGINT NOT NULL,
    quality SMALLINT NOT NULL,
    {SUMS},
    PRIMARY KEY (bucket_s, camera_id, setup_id, quality)
) {CLUSTERED};

CREATE TABLE set_aside (
    id {ID},
    node_id BIGINT NOT NULL,
    instance_id BIGINT,
    report BIGINT,
    received_ms BIGINT NOT NULL,
    cause TEXT NOT NULL,
    body TEXT NOT NULL
);
CREATE UNIQUE INDEX set_aside_by_report ON set_aside (instance_id, report);
CREATE INDEX set_aside_by_node ON set_aside (node_id, id);

CREATE TABLE gaps (
    id {ID},
    instance_id BIGINT NOT NULL,
    first_report BIGINT NOT NULL,
    last_report BIGINT NOT NULL,
    noticed_ms BIGINT NOT NULL,
    cause TEXT NOT NULL
);

CREATE TABLE changes (
    id {ID},
    at_ms BIGINT NOT NULL,
    node TEXT NOT NULL,
    camera TEXT NOT NULL,
    knob TEXT NOT NULL,
    from_value TEXT,
    to_value TEXT,
    revision BIGINT NOT NULL,
    who TEXT NOT NULL,
    why TEXT NOT NULL,
    outcome TEXT NOT NULL
);
CREATE INDEX changes_by_node ON changes (node, id);

CREATE TABLE events (
    id {ID},
    at_ms BIGINT NOT NULL,
    kind TEXT NOT NULL,
    node TEXT,
    detail TEXT NOT NULL
);
