use super::*;
use crate::choose::open;
use crate::config::PowerSource;
use crate::reading::Domain;
use crate::tests::Tree;
use rstest::rstest;
use std::process::Command;
use std::time::Duration;

/// A pretend NVML: a letter a card in `CARDS`; `c` counts 60 J at each question, `p` shows 60 W, `n` nothing.
const DRIVER: &str = r#"
#include <string.h>
static unsigned long long counted;
static char card(void *device) { return CARDS[(long)device - 1]; }
int nvmlInit_v2(void) { return 0; }
int nvmlShutdown(void) { return 0; }
int nvmlDeviceGetCount_v2(unsigned *count) { *count = strlen(CARDS); return 0; }
int nvmlDeviceGetHandleByIndex_v2(unsigned i, void **device) { *device = (void *)(long)(i + 1); return 0; }
int nvmlDeviceGetName(void *device, char *name, unsigned length) { strncpy(name, "Card", length); return 0; }
int nvmlDeviceGetTotalEnergyConsumption(void *device, unsigned long long *mj) {
    if (card(device) != 'c') return 3;
    *mj = counted += 60000;
    return 0;
}
int nvmlDeviceGetPowerUsage(void *device, unsigned *mw) {
    if (card(device) == 'n') return 3;
    *mw = 60000;
    return 0;
}
"#;

/// A PC with a processor counter, and cards that PCI lists and that NVML shows.
fn machine(pci: usize, nvml: Option<&str>) -> Tree {
    let tree = Tree::default();
    tree.write("proc/stat", "cpu 1 2 3 4 5 6 7 8");
    tree.rapl("intel-rapl:0", "package-0", 0);
    for device in 0..pci {
        let device = format!("sys/bus/pci/devices/0000:0{device}:00.0");
        tree.write(format!("{device}/vendor"), NVIDIA);
        tree.write(format!("{device}/class"), "0x030000");
    }
    // The card's own sound device, and another maker's card.
    for (device, vendor, class) in [
        ("0000:09:00.1", NVIDIA, "0x040300"),
        ("0000:0a:00.0", "0x8086", "0x030000"),
    ] {
        tree.write(format!("sys/bus/pci/devices/{device}/vendor"), vendor);
        tree.write(format!("sys/bus/pci/devices/{device}/class"), class);
    }
    if let Some(cards) = nvml {
        tree.write("nvml.c", DRIVER.replace("CARDS", &format!("\"{cards}\"")));
        let compiled = Command::new("cc")
            .args(["-shared", "-fPIC", "-o"])
            .args([tree.path("libnvidia-ml.so.1"), tree.path("nvml.c")])
            .status()
            .unwrap();
        assert!(compiled.success());
    }
    tree
}

/// A meter as it was read twice.
struct Watched {
    /// The source that was opened.
    source: &'static str,
    quality: EnergyQuality,
    total_from: String,
    /// The total over the second in which the processor used 20 J.
    watts: f64,
}

/// Opens a source and reads it twice.
fn watch(tree: &Tree, source: PowerSource) -> Watched {
    let config = PowerConfig {
        source,
        ..tree.config()
    };
    let (source, mut meter) = open(&config).unwrap();
    let start = Instant::now();
    let first = meter.poll(start).unwrap().remove(0);
    tree.rapl("intel-rapl:0", "package-0", 20_000_000);
    let last = meter.poll(start + Duration::from_secs(1)).unwrap().remove(0);
    let before = first.value(Domain::Total);
    let watts = last.value(Domain::Total).unwrap().mean_watts(before, 1.0);
    Watched {
        source: source.as_str(),
        quality: meter.quality(),
        total_from: last.total_from.into_owned(),
        watts: watts.unwrap(),
    }
}

#[rstest]
#[case::no_card(0, None, "rapl", EnergyQuality::Measured, "processor", 20.0)]
#[case::counting_card(
    1,
    Some("c"),
    "rapl+nvml",
    EnergyQuality::Measured,
    "processor + card",
    80.0
)]
#[case::card_that_shows_power(
    1,
    Some("p"),
    "rapl+nvml",
    EnergyQuality::Measured,
    "processor + card",
    80.0
)]
#[case::mixed_cards(
    2,
    Some("cp"),
    "rapl+nvml",
    EnergyQuality::Measured,
    "processor + 2 cards",
    140.0
)]
#[case::hidden_from_pci(
    0,
    Some("c"),
    "rapl+nvml",
    EnergyQuality::Measured,
    "processor + card",
    80.0
)]
#[case::second_card_without_readings(
    2,
    Some("cn"),
    "rapl+nvml",
    EnergyQuality::Partial,
    "processor + card, without card",
    80.0
)]
#[case::second_card_unknown_to_the_driver(
    2,
    Some("c"),
    "rapl+nvml",
    EnergyQuality::Partial,
    "processor + card, without card",
    80.0
)]
#[case::card_without_readings(
    1,
    Some("n"),
    "rapl",
    EnergyQuality::Partial,
    "processor, without card",
    20.0
)]
#[case::card_without_a_driver(
    2,
    None,
    "rapl",
    EnergyQuality::Partial,
    "processor, without 2 cards",
    20.0
)]
fn all_parts_that_consume_much_are_added_or_the_figure_is_partial(
    #[case] pci: usize,
    #[case] nvml: Option<&str>,
    #[case] source: &str,
    #[case] quality: EnergyQuality,
    #[case] total_from: &str,
    #[case] watts: f64,
) {
    let found = watch(&machine(pci, nvml), PowerSource::Auto);
    assert_eq!(found.source, source);
    assert_eq!(found.quality, quality);
    assert_eq!(found.total_from, total_from);
    assert!((found.watts - watts).abs() < 1e-6, "{} W", found.watts);
}

#[test]
fn a_meter_that_is_chosen_alone_says_what_it_leaves_out() {
    let tree = machine(1, Some("c"));
    let processor = watch(&tree, PowerSource::Rapl);
    assert_eq!(processor.quality, EnergyQuality::Partial);
    assert_eq!(processor.total_from, "processor, without card");
    assert_eq!(processor.watts, 20.0);

    let card = watch(&tree, PowerSource::Nvml);
    assert_eq!(card.quality, EnergyQuality::Partial);
    assert_eq!(card.total_from, "card, without processor");
    assert_eq!(card.watts, 60.0);
}

#[test]
fn cards_without_a_readable_processor_are_partial() {
    let tree = machine(1, Some("c"));
    std::fs::remove_dir_all(tree.path("sys/class/powercap")).unwrap();
    let (source, meter) = open(&tree.config()).unwrap();
    assert_eq!(source.as_str(), "nvml");
    assert_eq!(meter.quality(), EnergyQuality::Partial);
}

#[test]
fn beside_a_card_the_platform_counter_is_not_used() {
    let tree = machine(1, Some("c"));
    tree.rapl("intel-rapl:1", "psys", 0);
    let found = watch(&tree, PowerSource::Auto);
    assert_eq!(found.total_from, "processor + card");
    assert_eq!(found.watts, 80.0);
}
