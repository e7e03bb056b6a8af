-- The figures over the clips that had one value in force from begin to end, by node: how many have it, and their sum. Partly
-- metered energy (quality 1) is in none. A clip is filed under its begin, which lies less than a day before it is received if
-- anybody is to decide on it: without that bound every clip ever received would be looked at.
SELECT n.name AS node,
       count(*) FILTER (WHERE c.frames > 0) AS clips_skip_rate,
       sum(CAST(c.frames_e + c.frames_p - c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)) AS sum_skip_rate,
       count(c.energy_uj) FILTER (WHERE c.quality = 0) AS clips_joules_measured,
       sum(CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000) FILTER (WHERE c.quality = 0) AS sum_joules_measured,
       count(c.energy_uj) FILTER (WHERE c.quality = 2) AS clips_joules_estimated,
       sum(CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000) FILTER (WHERE c.quality = 2) AS sum_joules_estimated,
       count(c.edp) FILTER (WHERE c.quality = 0) AS clips_edp_measured,
       sum(c.edp) FILTER (WHERE c.quality = 0) AS sum_edp_measured,
       count(c.edp) FILTER (WHERE c.quality = 2) AS clips_edp_estimated,
       sum(c.edp) FILTER (WHERE c.quality = 2) AS sum_edp_estimated,
       count(c.latency_p99_us) AS clips_latency_p99,
       sum(CAST(c.latency_p99_us AS DOUBLE PRECISION) / 1000) AS sum_latency_p99,
       count(*) FILTER (WHERE c.frames > 0) AS clips_degraded,
       sum(CAST(c.degraded AS DOUBLE PRECISION) / NULLIF(c.frames, 0)) AS sum_degraded,
       count(c.audit_paired) FILTER (WHERE c.audit_detected > 0) AS clips_recall,
       sum(CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_detected, 0)) AS sum_recall,
       count(c.audit_paired) FILTER (WHERE c.audit_shown > 0) AS clips_precision,
       sum(CAST(c.audit_paired AS DOUBLE PRECISION) / NULLIF(c.audit_shown, 0)) AS sum_precision
FROM w
JOIN nodes n ON n.name = w.node
JOIN cameras k ON k.node_id = n.id
JOIN clips c ON c.camera_id = k.id AND c.at_ms >= w.from_ms - 86400000
JOIN setups s ON s.id = c.setup_id
WHERE s.threshold = w.threshold AND s.value = w.value
    AND c.received_ms >= w.from_ms AND c.received_ms <= w.until_ms
    AND c.threshold_changed = 0
GROUP BY n.name
