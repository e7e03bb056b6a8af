-- What is desired of nodes, by whom it was ordered, what became of it; rollouts and trials.
-- Values of knobs are texts, as in `setups`: the shortest that reads back as the same number.

CREATE TABLE counters (
    name TEXT NOT NULL PRIMARY KEY,
    value BIGINT NOT NULL
);
INSERT INTO counters (name, value) VALUES ('revision', 0);

CREATE TABLE desired (
    node TEXT NOT NULL PRIMARY KEY,
    revision BIGINT NOT NULL,
    knob TEXT NOT NULL,
    value TEXT NOT NULL
);
CREATE INDEX desired_by_revision ON desired (revision);

CREATE TABLE orders (
    revision BIGINT NOT NULL PRIMARY KEY,
    at_ms BIGINT NOT NULL,
    who TEXT NOT NULL,
    why TEXT NOT NULL,
    origin TEXT NOT NULL,
    selector TEXT NOT NULL,
    knob TEXT NOT NULL,
    value TEXT NOT NULL
);

CREATE TABLE order_nodes (
    revision BIGINT NOT NULL,
    node TEXT NOT NULL,
    from_value TEXT,
    outcome TEXT NOT NULL,
    at_ms BIGINT NOT NULL,
    detail TEXT NOT NULL,
    PRIMARY KEY (revision, node)
) {CLUSTERED};
CREATE INDEX order_nodes_by_node ON order_nodes (node, revision);
CREATE INDEX order_nodes_open ON order_nodes (revision)
    WHERE outcome IN ('pending', 'waiting', 'timed_out');

CREATE TABLE campaigns (
    id {ID},
    kind TEXT NOT NULL,
    begun_ms BIGINT NOT NULL,
    ended_ms BIGINT,
    who TEXT NOT NULL,
    driver TEXT NOT NULL,
    driven_until_ms BIGINT NOT NULL,
    state TEXT NOT NULL
);
CREATE INDEX campaigns_open ON campaigns (id) WHERE ended_ms IS NULL;
