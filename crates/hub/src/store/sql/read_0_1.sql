-- Shows a database of albireo 0.1 (tables of version 3 to 5) under the names of today, for moving it. Left out: targets,
-- rollouts, trials and audits, which mean something else today, and counts of reports, which carry no ids.
CREATE TEMP VIEW nodes AS
SELECT id, name, state, since_ms, why, heard_ms, generation AS revision, NULL AS status FROM main.nodes;

CREATE TEMP VIEW setups AS
SELECT id, policy, knob AS threshold, value, model, provider, power_source, total_from FROM main.setups;

CREATE TEMP VIEW clips AS
SELECT id, received_ms / 86400000 AS day, randomblob(16) AS report_id, camera_id, setup_id, at_ms, received_ms, clip,
    0 AS part, ended_by, duration_us, frames, frames_e, frames_p, frames_ei, frames_i, frames_ai, degraded, dropped,
    latency_mean_us, latency_p99_us, latency_us, detector_calls, detector_mean_us, detector_us, avoided_calls,
    avoided_uj, quality, energy_uj, node_uj, edp, coverage_ppm, 0 AS threshold_changed
FROM main.clips;

-- The sums of each camera, and under camera 0 those of the fleet, which are new.
CREATE TEMP VIEW side AS SELECT 0 AS is_camera UNION ALL SELECT 1;
CREATE TEMP VIEW sums_5m AS
SELECT bucket_s, camera_id * is_camera AS camera_id, setup_id, quality,
    sum(clips) AS clips, sum(duration_us) AS duration_us, sum(frames) AS frames, sum(frames_e) AS frames_e,
    sum(frames_p) AS frames_p, sum(frames_ei) AS frames_ei, sum(frames_i) AS frames_i, sum(frames_ai) AS frames_ai,
    sum(degraded) AS degraded, sum(dropped) AS dropped, sum(latency_us) AS latency_us,
    sum(detector_calls) AS detector_calls, sum(detector_us) AS detector_us, sum(avoided_calls) AS avoided_calls,
    sum(unpriced_calls) AS unpriced_calls, sum(avoided_uj) AS avoided_uj, sum(energy_uj) AS energy_uj,
    0 AS audit_frames, 0 AS audit_missed, 0 AS audit_missed_boxes, 0 AS audit_calls, 0 AS audit_us, 0 AS audit_uj,
    0 AS audit_detected, 0 AS audit_shown, 0 AS audit_paired, 0 AS audit_detected_sq, 0 AS audit_detected_x,
    0 AS audit_shown_sq, 0 AS audit_paired_sq, 0 AS audit_shown_x
FROM main.sums_5m CROSS JOIN side GROUP BY 1, 2, 3, 4;

-- Whole days of five-minute sums give hours; a day before them is filed under its first hour.
CREATE TEMP VIEW first_day AS
SELECT COALESCE((min(bucket_s) + 86399) / 86400 * 86400, 1 << 62) AS bucket_s FROM main.sums_5m;
CREATE TEMP VIEW sums_hour AS
SELECT bucket_s / 3600 * 3600 AS bucket_s, camera_id * is_camera AS camera_id, setup_id, quality,
    sum(clips) AS clips, sum(duration_us) AS duration_us, sum(frames) AS frames, sum(frames_e) AS frames_e,
    sum(frames_p) AS frames_p, sum(frames_ei) AS frames_ei, sum(frames_i) AS frames_i, sum(frames_ai) AS frames_ai,
    sum(degraded) AS degraded, sum(dropped) AS dropped, sum(latency_us) AS latency_us,
    sum(detector_calls) AS detector_calls, sum(detector_us) AS detector_us, sum(avoided_calls) AS avoided_calls,
    sum(unpriced_calls) AS unpriced_calls, sum(avoided_uj) AS avoided_uj, sum(energy_uj) AS energy_uj,
    0 AS audit_frames, 0 AS audit_missed, 0 AS audit_missed_boxes, 0 AS audit_calls, 0 AS audit_us, 0 AS audit_uj,
    0 AS audit_detected, 0 AS audit_shown, 0 AS audit_paired, 0 AS audit_detected_sq, 0 AS audit_detected_x,
    0 AS audit_shown_sq, 0 AS audit_paired_sq, 0 AS audit_shown_x
FROM (
    SELECT * FROM main.sums_5m WHERE bucket_s >= (SELECT bucket_s FROM first_day)
    UNION ALL SELECT * FROM main.sums_day WHERE bucket_s < (SELECT bucket_s FROM first_day)
) CROSS JOIN side GROUP BY 1, 2, 3, 4;

CREATE TEMP VIEW set_aside AS
SELECT id, node_id, NULL AS report_id, received_ms, cause, body FROM main.set_aside;

CREATE TEMP VIEW counters AS
SELECT 'revision' AS name, value FROM main.counters WHERE name = 'generation'
UNION ALL SELECT 'rollout', 0 UNION ALL SELECT 'trial', 0;

-- A target has no knob.
CREATE TEMP VIEW desired AS
SELECT node, generation AS revision,
    json_object('threshold', json_object('name', knob, 'value', CAST(value AS REAL))) AS setting
FROM main.desired WHERE knob <> '';

CREATE TEMP VIEW revisions AS
SELECT generation AS revision, at_ms, who, why, origin, selector,
    json_object('threshold', json_object('name', knob, 'value', CAST(value AS REAL))) AS setting
FROM main.orders WHERE knob <> '';

CREATE TEMP VIEW revision_nodes AS
SELECT n.generation AS revision, n.node,
    CASE WHEN n.from_value IS NOT NULL THEN
        json_object('threshold', json_object('name', o.knob, 'value', CAST(n.from_value AS REAL)))
    END AS setting_before,
    o.at_ms AS given_ms, CASE WHEN n.outcome IN ('applied', 'refused', 'superseded') THEN n.outcome ELSE 'missed' END AS outcome,
    n.at_ms, n.detail
FROM main.order_nodes n JOIN main.orders o ON o.generation = n.generation
WHERE o.knob <> '';
