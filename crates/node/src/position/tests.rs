use super::*;
use sentences::{Reading, gpsd, nmea};
use std::sync::Arc;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;

/// Recorded from a GlobalSat BU-353-S4 that stood in Hamilton, New Zealand (gpsd's test/daemon/bu353s4.log).
const NMEA: &str = "\
$GPRMC,030721.000,A,3747.0876,S,17518.8934,E,0.89,181.39,311214,,,A*71\r
$GPGGA,030721.000,3747.0876,S,17518.8934,E,1,08,1.1,60.1,M,23.7,M,,0000*7D\r
$GPGSA,A,3,17,28,06,01,30,20,26,13,,,,,1.8,1.1,1.5*33\r
$GPGSV,3,3,12,11,12,132,04,08,38,008,,02,35,348,,03,14,091,*73\r
";
/// What u-blox receivers send until they see satellites.
const NO_FIX: &str = "\
$GPRMC,,V,,,,,,,,,,N*53\r
$GPGGA,,,,,,0,00,99.99,,,,,,*48\r
";
/// What gpsd answers to a watch (the examples of gpsd_json(5)), and what it makes of the sentences above (bu353s4.log.chk).
const GPSD: &str = r#"{"class":"VERSION","release":"3.22","rev":"3.22","proto_major":3,"proto_minor":14}
{"class":"DEVICES","devices":[{"class":"DEVICE","path":"/dev/ttyUSB0","activated":1411468340}]}
{"class":"WATCH","enable":true,"json":true,"nmea":false,"raw":0,"scaled":false,"timing":false,"split24":false,"pps":false}
{"class":"TPV","device":"/dev/ttyUSB0","mode":1}
{"class":"SKY","gdop":2.01,"hdop":1.10,"pdop":1.80,"uSat":1,"satellites":[{"PRN":17,"az":207.0,"el":72.0,"ss":32.0,"used":true}]}
{"class":"TPV","mode":3,"time":"2034-08-16T03:07:21.000Z","ept":0.005,"lat":-37.784793333,"lon":175.314890000,"alt":60.1000,"track":181.3900,"speed":0.458,"eph":20.900}
"#;

/// A place that no receiver here gives.
const PLACE: Position = Position {
    latitude: 1.0,
    longitude: 2.0,
    speed_m_s: None,
};

#[track_caller]
fn assert_in_hamilton(position: Position) {
    assert!(
        (position.latitude + 37.784_793_333).abs() < 1e-8,
        "{position:?}"
    );
    assert!(
        (position.longitude - 175.314_89).abs() < 1e-8,
        "{position:?}"
    );
}

#[test]
fn sentences_of_nmea_give_position_and_speed() {
    let mut has_rmc = false;
    let read: Vec<_> = NMEA.lines().map(|line| nmea(line, &mut has_rmc)).collect();
    let Reading::Fix(position) = read[0] else {
        panic!("{read:?}");
    };
    assert_in_hamilton(position);
    assert!((position.speed_m_s.unwrap() - 0.458).abs() < 0.001);
    assert_eq!(read[1..], [Reading::Other, Reading::Other, Reading::Other]);
    let read: Vec<_> = NO_FIX.lines().map(|line| nmea(line, &mut has_rmc)).collect();
    assert!(matches!(read[0], Reading::NoFix(_)), "{read:?}");

    // A receiver that sends only GGA has positions without speed.
    let mut has_rmc = false;
    let gga = nmea(NMEA.lines().nth(1).unwrap(), &mut has_rmc);
    let Reading::Fix(position) = gga else {
        panic!("{gga:?}");
    };
    assert_in_hamilton(position);
    assert_eq!(position.speed_m_s, None);
}

#[test]
fn what_is_no_sentence_says_why() {
    let mut has_rmc = false;
    let mut reason = |line: &str| match nmea(line, &mut has_rmc) {
        Reading::Unreadable(reason) => reason,
        other => format!("{other:?}"),
    };
    let garbled = NMEA.replace("3747.0876", "3747.0877");
    let wrong = reason(garbled.lines().next().unwrap());
    assert!(wrong.contains("checksum"), "{wrong}");
    let noise = reason("\u{fffd}\u{fffd}x\u{fffd}");
    assert!(noise.contains("stty"), "{noise}");
    assert_eq!(reason("$PMTK011,MTKGPS*08"), "Other");
    assert_eq!(
        reason("!AIVDM,1,1,,A,H42O55i18tMET00000000000000,2*6D"),
        "Other"
    );
    let nowhere = r#"{"class":"TPV","mode":3,"lat":97.0,"lon":8.5}"#;
    for line in ["$GPRMC", nowhere] {
        assert!(matches!(gpsd(line), Reading::Unreadable(_)), "{line}");
    }
    let none = gpsd(r#"{"class":"DEVICES","devices":[]}"#);
    assert!(matches!(none, Reading::NoFix(_)), "{none:?}");
}

#[test]
fn a_sentence_with_a_position_and_without_a_checksum_says_so() {
    let mut has_rmc = false;
    for line in NMEA.lines().take(2) {
        let (bare, _) = line.split_once('*').unwrap();
        let read = nmea(bare, &mut has_rmc);
        let Reading::Unreadable(reason) = &read else {
            panic!("{bare}: {read:?}");
        };
        assert!(reason.contains("no checksum"), "{reason}");
    }
    let bare = "$GPGSV,3,3,12,11,12,132,04";
    assert_eq!(nmea(bare, &mut has_rmc), Reading::Other);
}

#[test]
fn a_source_is_read_by_its_form_and_written_as_it_was() {
    let source = |text: &str| PositionSource::try_from(text.to_owned());
    for (text, written) in [
        ("off", "off"),
        ("frames", "frames"),
        ("gpsd://localhost", "gpsd://localhost:2947"),
        ("gpsd://[::1]/", "gpsd://[::1]:2947"),
        ("gpsd://10.0.0.1:2948", "gpsd://10.0.0.1:2948"),
        ("tcp://192.168.0.9:10110", "tcp://192.168.0.9:10110"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0"),
    ] {
        assert_eq!(source(text).unwrap().to_string(), written);
    }
    for text in [
        "",
        "gps",
        "gpsd://",
        "tcp://host",
        "tcp://host:0",
        "udp://host:1",
    ] {
        assert!(source(text).is_err(), "{text}");
    }
}

#[test]
fn a_receiver_that_is_not_there_is_told_when_the_configuration_is_checked() {
    let fault = |source: &str| {
        let mut config = crate::config::NodeConfig::default();
        config.position.source = source.to_owned().try_into().unwrap();
        config.position_fault().unwrap_or_default()
    };
    assert_eq!(fault("frames"), "");
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let there = format!("gpsd://{}", listener.local_addr().unwrap());
    assert_eq!(fault(&there), "");
    for source in ["gpsd://127.0.0.1:1", "/nowhere/ttyUSB0"] {
        let fault = fault(source);
        let begin = format!("position.source: {source} cannot be used now: ");
        assert!(fault.starts_with(&begin), "{fault}");
    }
}

fn positions(source: &str) -> Arc<Positions> {
    let source = source.to_owned().try_into().unwrap();
    Arc::new(Positions::new(&PositionConfig { source }))
}

/// Reads the receiver until frames have its position.
async fn until_known(positions: &Arc<Positions>) -> Position {
    let known = async {
        loop {
            if let Some(position) = positions.of_frame("front", None) {
                return position;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::select! {
        () = follow(Arc::clone(positions)) => unreachable!("it never ends"),
        known = tokio::time::timeout(Duration::from_secs(120), known) => known.unwrap(),
    }
}

#[tokio::test]
async fn a_gpsd_is_asked_and_its_positions_are_those_of_frames() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let positions = positions(&format!("gpsd://{}", listener.local_addr().unwrap()));
    let serve = tokio::spawn(async move {
        let (stream, _) = listener.accept().await.unwrap();
        let mut stream = BufReader::new(stream);
        let mut asked = String::new();
        stream.read_line(&mut asked).await.unwrap();
        stream.get_mut().write_all(GPSD.as_bytes()).await.unwrap();
        (asked, stream)
    });
    assert_in_hamilton(until_known(&positions).await);
    let (asked, _stream) = serve.await.unwrap();
    assert_eq!(asked, "?WATCH={\"enable\":true,\"json\":true};\n");
    let found = positions.of_frame("front", Some(&Ok(PLACE)));
    assert_eq!(found, Some(PLACE), "the frame's own position comes first");
    assert_eq!(positions.fault(), None);
}

#[tokio::test]
async fn nmea_is_read_from_a_network_a_fifo_and_a_growing_file() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let network = positions(&format!("tcp://{}", listener.local_addr().unwrap()));
    let serve = tokio::spawn(async move {
        let (mut stream, _) = listener.accept().await.unwrap();
        // From the middle of a sentence on, as a receiver that has been sending.
        let lines = format!("8.9,181.39,311214,,,A*71\r\n{NMEA}");
        stream.write_all(lines.as_bytes()).await.unwrap();
        stream
    });
    assert_in_hamilton(until_known(&network).await);
    let _stream = serve.await.unwrap();
    assert_eq!(network.status().refused, 0);

    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("nmea");
    let made = std::process::Command::new("mkfifo").arg(&fifo).status();
    assert!(made.unwrap().success());
    let piped = positions(fifo.to_str().unwrap());
    // Blocks until the node has opened it.
    let writing = tokio::task::spawn_blocking(move || std::fs::write(fifo, NMEA).unwrap());
    assert_in_hamilton(until_known(&piped).await);
    writing.await.unwrap();

    let file = folder.path().join("log");
    std::fs::write(&file, NO_FIX).unwrap();
    let grown = positions(file.to_str().unwrap());
    let grow = async {
        while grown.status().words.is_empty() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(grown.status().words.contains("satellites"));
        std::fs::write(&file, format!("{NO_FIX}{NMEA}")).unwrap();
    };
    let (position, ()) = tokio::join!(until_known(&grown), grow);
    assert_in_hamilton(position);
}

#[tokio::test]
async fn a_receiver_that_comes_back_is_read_again() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let positions = positions(&format!("tcp://{address}"));
    let serve = tokio::spawn(async move {
        let (first, _) = listener.accept().await.unwrap();
        drop(first);
        let (mut second, _) = listener.accept().await.unwrap();
        second.write_all(NMEA.as_bytes()).await.unwrap();
        second
    });
    assert_in_hamilton(until_known(&positions).await);
    let _stream = serve.await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_receiver_that_is_away_is_a_fault_and_one_in_a_garage_is_not() {
    // Nobody listens on port 1.
    let away = positions("gpsd://127.0.0.1:1");
    let reading = tokio::spawn(follow(Arc::clone(&away)));
    while away.fault().is_none() {
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    let fault = away.fault().unwrap();
    assert!(fault.contains("cannot connect"), "{fault}");
    assert!(fault.contains("next attempt in 5 s"), "{fault}");
    reading.abort();

    let garage = positions("/dev/ttyUSB0");
    for _ in 0..100 {
        garage.searching("it sees too few satellites");
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(garage.fault(), None);
    }
    assert_eq!(garage.status().words, "it sees too few satellites");
    garage.found(PLACE);
    assert_eq!(garage.of_frame("front", None), Some(PLACE));
    assert_eq!(garage.status().words, "it gives positions");
    tokio::time::sleep(FRESH).await;
    assert_eq!(garage.of_frame("front", None), None, "it is too old");
    assert_eq!(garage.status().words, "its last position is 10 s old");
    assert_eq!(garage.fault(), None);
    tokio::time::sleep(SILENT).await;
    let fault = garage.fault().unwrap();
    assert_eq!(
        fault,
        "/dev/ttyUSB0 gives no position: its last position is 40 s old"
    );
}

#[tokio::test(start_paused = true)]
async fn a_position_of_a_frame_that_cannot_be_right_is_told_for_a_minute() {
    let frames = positions("frames");
    let wrong = Err("latitude is 91, not from -90 to 90".to_owned());
    assert_eq!(frames.of_frame("front", Some(&wrong)), None);
    let fault = frames.fault().unwrap();
    assert_eq!(
        fault,
        "a frame of front: latitude is 91, not from -90 to 90 (1 since the start)"
    );
    tokio::time::sleep(REFUSED_FOR).await;
    assert_eq!(frames.fault(), None);
    assert_eq!(frames.status().refused, 1);

    let off = positions("off");
    assert_eq!(off.of_frame("front", Some(&Ok(PLACE))), None);
    assert_eq!(off.status().ignored, 1);
    assert_eq!(off.fault(), None);
}
