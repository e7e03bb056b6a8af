-- Deletes rows before day $1, at most 1000 per statement, each with its own bound. Ids grow in the order of receipt, and a
-- clip's day is at most one day after its receipt: only the lowest ids are looked at. They are more than 1000, so that
-- a few clips that stay do not make a step look like the last one.
DELETE FROM clips WHERE id IN (
    SELECT id FROM (SELECT id, day FROM clips ORDER BY id LIMIT 5000) AS lowest WHERE day < $1 LIMIT 1000
) RETURNING 1 AS gone;

-- One day at a time: a list of pairs would look at all ids of a day for each.
WITH oldest AS (SELECT min(day) AS day FROM report_ids WHERE day > 0 AND day < $1)
DELETE FROM report_ids WHERE day = (SELECT day FROM oldest) AND id IN (
    SELECT id FROM report_ids WHERE day = (SELECT day FROM oldest) LIMIT 1000
) RETURNING 1 AS gone;

-- Identities under their day of receipt, which is negative.
WITH oldest AS (SELECT max(day) AS day FROM report_ids WHERE day < 0 AND day > -$1)
DELETE FROM report_ids WHERE day = (SELECT day FROM oldest) AND id IN (
    SELECT id FROM report_ids WHERE day = (SELECT day FROM oldest) LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM sums_5m WHERE (camera_id, bucket_s, setup_id, quality) IN (
    SELECT camera_id, bucket_s, setup_id, quality FROM sums_5m
    WHERE camera_id IN (SELECT 0 UNION ALL SELECT id FROM cameras) AND bucket_s < $1 * 86400 LIMIT 1000
) RETURNING 1 AS gone
