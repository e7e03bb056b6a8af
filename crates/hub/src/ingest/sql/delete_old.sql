-- Deletes rows before day $1, at most 1000 per statement, each with its own bound.
DELETE FROM events WHERE id IN (
    SELECT id FROM events WHERE at_ms < $1 * 86400000 AND id < (SELECT COALESCE(min(id), 0) FROM events) + 1000
) RETURNING 1 AS gone;

DELETE FROM set_aside WHERE id IN (
    SELECT id FROM set_aside WHERE received_ms < $1 * 86400000
        AND id < (SELECT COALESCE(min(id), 0) FROM set_aside) + 1000
) RETURNING 1 AS gone
