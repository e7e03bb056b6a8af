-- What was ordered stands in `orders` and `order_nodes`; this table never had a row.
DROP TABLE changes;
