//! From closed clips to published reports. A camera's desk keeps the books; one reporter for the node adds
//! the energy, publishes, and keeps what nobody has taken yet.

use super::board::Board;
use super::intake::DropLedger;
use super::spool::Spool;
use crate::clip::{ClipBooks, ClipEntry, ClosedClip, Ledger, ReportContext};
use crate::detector::DetectorHandle;
use crate::frame::Frame;
use crate::power::PowerHandle;
use crate::wire::ClipReport;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};
