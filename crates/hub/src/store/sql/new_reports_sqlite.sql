-- Notes one report, unless it is known under its own day or without one.
INSERT INTO report_ids (day, id)
SELECT :day, :id
WHERE NOT EXISTS (SELECT 1 FROM report_ids WHERE day = :own_day AND id = :id)
    AND NOT EXISTS (SELECT 1 FROM report_ids WHERE id = :id AND day < 0)
ON CONFLICT DO NOTHING
RETURNING id
