-- Deletes rows before day $1, at most 1000 per statement, each with its own bound.
DELETE FROM events WHERE id IN (
    SELECT id FROM events WHERE at_ms < $1 * 86400000 AND id < (SELECT COALESCE(min(id), 0) FROM events) + 1000
) RETURNING 1 AS gone;

-- Desired settings stay: a node that returns after years still gets its setting.
DELETE FROM order_nodes WHERE (revision, node) IN (
    SELECT revision, node FROM order_nodes
    WHERE revision IN (SELECT revision FROM orders WHERE at_ms < $1 * 86400000) LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM orders WHERE revision IN (
    SELECT o.revision FROM orders o WHERE o.at_ms < $1 * 86400000
        AND NOT EXISTS (SELECT 1 FROM order_nodes n WHERE n.revision = o.revision) LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM set_aside WHERE id IN (
    SELECT id FROM set_aside WHERE received_ms < $1 * 86400000
        AND id < (SELECT COALESCE(min(id), 0) FROM set_aside) + 1000
) RETURNING 1 AS gone
