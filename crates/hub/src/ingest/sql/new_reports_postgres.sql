-- Notes reports, but for those that are known under their own day or without one.
INSERT INTO report_ids (day, id)
SELECT k.day, k.id
FROM jsonb_to_recordset($1::jsonb) AS k (day BIGINT, id BYTEA, own_day BIGINT)
WHERE NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.day = k.own_day AND r.id = k.id)
    AND NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.id = k.id AND r.day < 0)
ORDER BY 1, 2
ON CONFLICT DO NOTHING
RETURNING id
