//! The HTTP interface of a node over real connections: every answer a client can get.

mod access;
mod connections;
mod documented;
pub(crate) mod events;
mod history;
mod policy;
mod resources;
mod screen;
pub(crate) mod served;
mod threshold;
