
LEFT JOIN cameras m ON m.id = t.camera_id
LEFT JOIN nodes n ON n.id = m.node_id
JOIN setups s ON s.id = t.setup_id
WHERE t.bucket_s >= $2 AND t.bucket_s < $3 AND t.camera_id IN
