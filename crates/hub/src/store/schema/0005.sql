-- What a node is to hold in the place of its knob's number: `skip_rate=0.5`, or `off` where nothing is to be held; knob and
-- value are then empty. Null where a value of the knob was ordered, as everywhere before.
ALTER TABLE desired ADD COLUMN target TEXT;
ALTER TABLE orders ADD COLUMN target TEXT;

-- What a node had before an order: a target, or the value in `from_value` of the knob in `from_knob`; null where that is the
-- order's own knob, as in all rows before.
ALTER TABLE order_nodes ADD COLUMN from_knob TEXT;
ALTER TABLE order_nodes ADD COLUMN from_target TEXT;
