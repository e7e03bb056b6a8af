-- What the clips of one day used and skipped, by node. Energy of quality 2 is estimated.
SELECT n.name AS node,
       COALESCE(SUM(CAST(t.energy_uj AS DOUBLE PRECISION)) FILTER (WHERE t.quality <> 2), 0) / 1000000 AS measured_joules,
       COALESCE(SUM(CAST(t.energy_uj AS DOUBLE PRECISION)) FILTER (WHERE t.quality = 2), 0) / 1000000 AS estimated_joules,
       SUM(CAST(t.avoided_calls AS DOUBLE PRECISION)) / NULLIF(SUM(CAST(t.frames AS DOUBLE PRECISION)), 0) AS skip_rate,
       SUM(CAST(t.audit_paired AS DOUBLE PRECISION)) / NULLIF(SUM(CAST(t.audit_detected AS DOUBLE PRECISION)), 0) AS recall
FROM cameras c
JOIN nodes n ON n.id = c.node_id
JOIN sums_hour t ON t.camera_id = c.id
WHERE t.bucket_s >= $1 AND t.bucket_s < $1 + 86400
GROUP BY n.name
