-- Nodes with what is known of their reports; zeros where none came yet.
SELECT n.name,
       n.id AS node_id,
       (SELECT count(*) FROM cameras c WHERE c.node_id = n.id) AS cameras,
       COALESCE(r.first_ms, 0) AS first_ms,
       COALESCE(r.last_ms, 0) AS last_ms,
       COALESCE(r.stored, 0) AS stored,
       COALESCE(r.set_aside, 0) AS set_aside,
       COALESCE(r.refused, 0) AS refused,
       COALESCE(r.missing, 0) AS missing,
       COALESCE(r.resets, 0) AS resets,
       COALESCE(r.base, 0) AS base,
       COALESCE(r.highest, 0) AS highest,
       COALESCE(r.ranges, '[]') AS ranges,
       COALESCE(r.displaced, '[0,0]') AS displaced
FROM nodes n
LEFT JOIN report_counts r ON r.node_id = n.id
WHERE n.name IN
