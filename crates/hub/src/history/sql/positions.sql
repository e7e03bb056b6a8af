-- Clips with positions, the last first. A node's joules per kilometre are known only where both figures are whole.
SELECT c.id,
       n.name AS node,
       m.name AS camera,
       c.clip,
       c.part,
       c.at_ms,
       CAST(c.duration_us AS DOUBLE PRECISION) / 1000000 AS duration_s,
       c.frames,
       CASE c.frames WHEN 0 THEN 0 ELSE CAST(c.avoided_calls AS DOUBLE PRECISION) / c.frames END AS skip_rate,
       CAST(c.distance_mm AS DOUBLE PRECISION) / 1000 AS distance_m,
       CASE c.quality WHEN 0 THEN 'measured' WHEN 1 THEN 'partial' WHEN 2 THEN 'estimated' ELSE 'unavailable' END AS quality,
       CAST(c.energy_uj AS DOUBLE PRECISION) / 1000000 AS joules,
       CASE WHEN c.coverage_ppm >= 999000
           THEN CAST(c.node_uj AS DOUBLE PRECISION) / NULLIF(c.distance_mm, 0) END AS joules_per_km,
       c.travel
FROM clips c
JOIN cameras m ON m.id = c.camera_id
JOIN nodes n ON n.id = m.node_id
WHERE c.distance_mm IS NOT NULL AND c.at_ms >= $1 AND c.at_ms < $2
    AND ($3 = '' OR n.name = $3) AND ($4 = '' OR m.name = $4)
ORDER BY c.at_ms DESC, c.id DESC
LIMIT $5
