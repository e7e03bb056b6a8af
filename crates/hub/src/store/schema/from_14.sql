-- What tables of version 14 lack: where clips were made, and the distance of sums.
ALTER TABLE clips ADD COLUMN distance_mm BIGINT;
ALTER TABLE clips ADD COLUMN travel TEXT;
CREATE INDEX clips_with_positions ON clips (at_ms) WHERE distance_mm IS NOT NULL;
ALTER TABLE sums_5m ADD COLUMN travel_mm BIGINT NOT NULL DEFAULT 0;
ALTER TABLE sums_5m ADD COLUMN travel_uj BIGINT NOT NULL DEFAULT 0;
ALTER TABLE sums_hour ADD COLUMN travel_mm BIGINT NOT NULL DEFAULT 0;
ALTER TABLE sums_hour ADD COLUMN travel_uj BIGINT NOT NULL DEFAULT 0;
UPDATE hub_meta SET value = '15' WHERE key = 'version';
