-- Sums of one group and one energy quality. Added up as floating-point numbers: no sum is too large for them, and they are
-- exact to 2^53.
SELECT CASE $1
           WHEN 'node' THEN n.name
           WHEN 'camera' THEN n.name || '/' || m.name
           WHEN 'clip' THEN n.name || '/' || m.name || '/' || t.clip
           WHEN 'day' THEN CAST(t.bucket_s - t.bucket_s % 86400 AS TEXT)
           WHEN 'policy' THEN s.policy
           WHEN 'threshold' THEN s.policy || CASE s.threshold WHEN '' THEN '' ELSE ' ' || s.threshold || '=' || s.value END
           ELSE ''
       END AS "group",
       CASE t.quality WHEN 0 THEN 'measured' WHEN 1 THEN 'partial' WHEN 2 THEN 'estimated' ELSE 'unavailable' END AS quality,
       COALESCE(SUM(CAST(t.clips AS DOUBLE PRECISION)), 0) AS clips,
       COALESCE(SUM(CAST(t.duration_us AS DOUBLE PRECISION)), 0) / 1000000 AS duration_s,
       COALESCE(SUM(CAST(t.frames AS DOUBLE PRECISION)), 0) AS frames,
       COALESCE(SUM(CAST(t.avoided_calls AS DOUBLE PRECISION)), 0) AS avoided_calls,
       COALESCE(SUM(CAST(t.unpriced_calls AS DOUBLE PRECISION)), 0) AS unpriced_calls,
       COALESCE(SUM(CAST(t.detector_calls AS DOUBLE PRECISION)), 0) AS detector_calls,
       COALESCE(SUM(CAST(t.avoided_calls AS DOUBLE PRECISION))
           / NULLIF(SUM(CAST(t.frames AS DOUBLE PRECISION)), 0), 0) AS skip_rate,
       COALESCE(SUM(CAST(t.energy_uj AS DOUBLE PRECISION)), 0) / 1000000 AS joules,
       NULLIF(SUM(CAST(t.travel_mm AS DOUBLE PRECISION)), 0) / 1000000 AS distance_km,
       SUM(CAST(t.travel_uj AS DOUBLE PRECISION)) / NULLIF(SUM(CAST(t.travel_mm AS DOUBLE PRECISION)), 0) AS joules_per_km,
       COALESCE(SUM(CAST(t.avoided_uj AS DOUBLE PRECISION)), 0) / 1000000 AS saved_joules_estimated,
       COALESCE(SUM(CAST(t.audit_uj AS DOUBLE PRECISION)), 0) / 1000000 AS audit_joules,
       SUM(CAST(t.audit_frames AS DOUBLE PRECISION)) AS audit_frames,
       SUM(CAST(t.audit_missed AS DOUBLE PRECISION)) AS audit_missed,
       SUM(CAST(t.audit_missed_boxes AS DOUBLE PRECISION)) AS audit_missed_boxes,
       SUM(CAST(t.audit_calls AS DOUBLE PRECISION)) AS audit_calls,
       SUM(CAST(t.audit_us AS DOUBLE PRECISION)) AS audit_us,
       SUM(CAST(t.audit_detected AS DOUBLE PRECISION)) AS audit_detected,
       SUM(CAST(t.audit_shown AS DOUBLE PRECISION)) AS audit_shown,
       SUM(CAST(t.audit_paired AS DOUBLE PRECISION)) AS audit_paired,
       SUM(CAST(t.audit_detected_sq AS DOUBLE PRECISION)) AS audit_detected_sq,
       SUM(CAST(t.audit_detected_x AS DOUBLE PRECISION)) AS audit_detected_x,
       SUM(CAST(t.audit_shown_sq AS DOUBLE PRECISION)) AS audit_shown_sq,
       SUM(CAST(t.audit_paired_sq AS DOUBLE PRECISION)) AS audit_paired_sq,
       SUM(CAST(t.audit_shown_x AS DOUBLE PRECISION)) AS audit_shown_x
