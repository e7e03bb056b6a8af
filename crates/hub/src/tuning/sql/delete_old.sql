-- Deletes revisions before day $1, at most 1000 rows per statement.
-- Desired settings stay: a node that returns after years still gets its setting.
DELETE FROM revision_nodes WHERE (revision, node) IN (
    SELECT revision, node FROM revision_nodes
    WHERE revision IN (SELECT revision FROM revisions WHERE at_ms < $1 * 86400000) LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM revisions WHERE revision IN (
    SELECT r.revision FROM revisions r WHERE r.at_ms < $1 * 86400000
        AND NOT EXISTS (SELECT 1 FROM revision_nodes n WHERE n.revision = r.revision) LIMIT 1000
) RETURNING 1 AS gone
