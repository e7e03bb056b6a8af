-- Deletes changes before day $1, at most 1000 rows per statement.
-- Desired settings stay: a node that returns after years still gets its setting.
DELETE FROM order_nodes WHERE (revision, node) IN (
    SELECT revision, node FROM order_nodes
    WHERE revision IN (SELECT revision FROM orders WHERE at_ms < $1 * 86400000) LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM orders WHERE revision IN (
    SELECT o.revision FROM orders o WHERE o.at_ms < $1 * 86400000
        AND NOT EXISTS (SELECT 1 FROM order_nodes n WHERE n.revision = o.revision) LIMIT 1000
) RETURNING 1 AS gone
