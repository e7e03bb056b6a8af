-- Notes a report of day ?1 with identity ?2, unless that is known under its own day ?3 or without one.
INSERT INTO report_ids (day, id)
SELECT ?1, ?2
WHERE NOT EXISTS (SELECT 1 FROM report_ids WHERE day = ?3 AND id = ?2)
    AND NOT EXISTS (SELECT 1 FROM report_ids WHERE id = ?2 AND day < 0)
ON CONFLICT DO NOTHING
RETURNING id
