-- Brings tables of version 15 to version 16: one word for a desired setting.
ALTER TABLE orders RENAME TO revisions;
ALTER TABLE revisions RENAME COLUMN "select" TO selector;
ALTER TABLE revisions RENAME COLUMN "to" TO setting;

ALTER TABLE order_nodes RENAME TO revision_nodes;
ALTER TABLE revision_nodes RENAME COLUMN "from" TO setting_before;
ALTER TABLE revision_nodes RENAME COLUMN asked_ms TO given_ms;
DROP INDEX order_nodes_by_node;
DROP INDEX order_nodes_open;
CREATE INDEX revision_nodes_by_node ON revision_nodes (node, revision);
CREATE INDEX revision_nodes_open ON revision_nodes (revision)
    WHERE outcome IN ('pending', 'waiting', 'timed_out');

-- The members of a rollout or trial. In a text that a person wrote, a quotation mark has a backslash before it.
UPDATE runs SET state = replace(replace(state, '"asked_ms":', '"given_ms":'), '"asked":', '"value":');
UPDATE hub_meta SET value = '16' WHERE key = 'version';
