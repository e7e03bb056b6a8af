//! Tests of presence: the state function by table, and the fleet over time.
