-- What tables of version 16 lack: which running counts are in doubt.
ALTER TABLE report_counts ADD COLUMN displaced TEXT NOT NULL DEFAULT '[0,0]';
UPDATE hub_meta SET value = '17' WHERE key = 'version';
