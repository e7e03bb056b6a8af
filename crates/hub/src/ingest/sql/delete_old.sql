-- Deletes rows before day $1, at most 1000 per statement, each with its own bound. Ids grow in the order of receipt:
-- only the lowest ids are looked at. They are more than 1000, so that a few rows of a clock that was ahead hold back no
-- others.
DELETE FROM events WHERE id IN (
    SELECT id FROM (SELECT id, at_ms FROM events ORDER BY id LIMIT 5000) AS lowest
    WHERE at_ms < $1 * 86400000 LIMIT 1000
) RETURNING 1 AS gone;

DELETE FROM set_aside WHERE id IN (
    SELECT id FROM (SELECT id, received_ms FROM set_aside ORDER BY id LIMIT 5000) AS lowest
    WHERE received_ms < $1 * 86400000 LIMIT 1000
) RETURNING 1 AS gone
