//! Reads a line of a receiver: NMEA 0183, or the JSON of gpsd.

use albireo_wire::Position;
use nmea::ParseResult;
use nmea::sentences::FixType;
use nmea::sentences::rmc::RmcStatusOfFix;
use serde::Deserialize;

/// Metres per second in a knot.
const KNOT: f64 = 1852.0 / 3600.0;

/// What a line says.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Reading {
    /// A position.
    Fix(Position),
    /// The receiver works and has no position; the reason in words.
    NoFix(&'static str),
    /// Something else that a receiver may say.
    Other,
    /// It cannot be read; the reason in words.
    Unreadable(String),
}

/// The positions in lines of NMEA 0183 or of gpsd.
pub fn positions_in(text: &str) -> Vec<Position> {
    let mut has_rmc = false;
    let mut positions = Vec::new();
    for line in text.lines() {
        for reading in [nmea(line, &mut has_rmc), gpsd(line)] {
            if let Reading::Fix(position) = reading {
                positions.push(position);
            }
        }
    }
    positions
}

/// Reads a line of NMEA 0183: RMC has position and speed. GGA, which has no speed, counts only for receivers that do not
/// send RMC (`has_rmc`).
pub(super) fn nmea(line: &str, has_rmc: &mut bool) -> Reading {
    let line = line.trim();
    // AIS, and receivers that say something before they begin.
    if line.is_empty() || line.starts_with(['!', '#']) {
        return Reading::Other;
    }
    let no_fix = Reading::NoFix("it sees too few satellites");
    match nmea::parse_str(line) {
        Ok(ParseResult::RMC(rmc)) => {
            *has_rmc = true;
            let is_valid = rmc.status_of_fix != RmcStatusOfFix::Invalid;
            let speed = rmc.speed_over_ground.map(|knots| f64::from(knots) * KNOT);
            match (rmc.lat, rmc.lon) {
                (Some(latitude), Some(longitude)) if is_valid => fix(latitude, longitude, speed),
                _ => no_fix,
            }
        }
        Ok(ParseResult::GGA(gga)) if !*has_rmc => {
            let is_valid = gga.fix_type.is_some_and(|kind| kind != FixType::Invalid);
            match (gga.latitude, gga.longitude) {
                (Some(latitude), Some(longitude)) if is_valid => {
                    let no_speed = None;
                    fix(latitude, longitude, no_speed)
                }
                _ => no_fix,
            }
        }
        Ok(_) => Reading::Other,
        Err(nmea::Error::ChecksumMismatch { .. }) => {
            Reading::Unreadable("a sentence of NMEA has a wrong checksum".to_owned())
        }
        Err(_) if lacks_checksum(line) => Reading::Unreadable(
            "a sentence of NMEA with a position has no checksum, such as *6A at its end: it must not be left out"
                .to_owned(),
        ),
        // A sentence of a kind that is not known here has a form that is.
        Err(_) if line.starts_with('$') && line.contains(',') => Reading::Other,
        Err(_) => {
            let start: String = line.chars().take(20).collect();
            Reading::Unreadable(format!(
                "{start:?} is no sentence of NMEA; of a serial port, set the speed: stty -F /dev/ttyS0 9600"
            ))
        }
    }
}

/// True for a sentence with a position that has no checksum.
fn lacks_checksum(line: &str) -> bool {
    let Some((kind, _)) = line.split_once(',') else {
        return false;
    };
    let has_position = kind.ends_with("RMC") || kind.ends_with("GGA");
    kind.starts_with('$') && has_position && !line.contains('*')
}

/// Reads a line of gpsd (gpsd_json(5)).
pub(super) fn gpsd(line: &str) -> Reading {
    #[derive(Deserialize)]
    struct Report {
        class: String,
        mode: Option<u8>,
        lat: Option<f64>,
        lon: Option<f64>,
        speed: Option<f64>,
        message: Option<String>,
        devices: Option<Vec<serde_json::Value>>,
    }
    let report: Report = match serde_json::from_str(line) {
        Ok(report) => report,
        Err(_) => return Reading::Unreadable("it does not answer as gpsd does".to_owned()),
    };
    match report.class.as_str() {
        "TPV" if report.mode.is_none_or(|mode| mode < 2) => {
            Reading::NoFix("it sees too few satellites")
        }
        "TPV" => match (report.lat, report.lon) {
            (Some(latitude), Some(longitude)) => fix(latitude, longitude, report.speed),
            _ => Reading::NoFix("it sees too few satellites"),
        },
        "DEVICES" if report.devices.is_some_and(|devices| devices.is_empty()) => {
            Reading::NoFix("gpsd has no receiver: name its device in /etc/default/gpsd")
        }
        "ERROR" => Reading::Unreadable(report.message.unwrap_or_default()),
        _ => Reading::Other,
    }
}

fn fix(latitude: f64, longitude: f64, speed_m_s: Option<f64>) -> Reading {
    let position = Position {
        latitude,
        longitude,
        speed_m_s,
    };
    match position.check() {
        Ok(()) => Reading::Fix(position),
        Err(reason) => Reading::Unreadable(reason),
    }
}
