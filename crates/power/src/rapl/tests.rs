//! Promises of the RAPL counters.

use super::*;

/// A powercap tree in the layout of the kernel's documentation.
struct Tree(tempfile::TempDir);

impl Tree {
    fn new(zones: &[(&str, &str, u64)]) -> Self {
        let tree = Self(tempfile::tempdir().unwrap());
        for (path, name, energy) in zones {
            let directory = tree.path(path);
            std::fs::create_dir_all(&directory).unwrap();
            std::fs::write(directory.join("name"), format!("{name}\n")).unwrap();
            std::fs::write(directory.join("max_energy_range_uj"), "262143328850\n").unwrap();
            tree.set(path, *energy);
        }
        tree
    }

    fn path(&self, zone: &str) -> PathBuf {
        self.0.path().join("class/powercap").join(zone)
    }

    fn set(&self, zone: &str, energy: u64) {
        std::fs::write(self.path(zone).join("energy_uj"), format!("{energy}\n")).unwrap();
    }

    fn open(&self) -> Result<Rapl, MeterError> {
        Rapl::open(&PowerConfig {
            sysfs: self.0.path().to_owned(),
            ..PowerConfig::default()
        })
    }
}

/// The reading a second after the first, before which these zones rise to these counts.
fn second_reading(tree: &Tree, counts: &[(&str, u64)]) -> Reading {
    let mut meter = tree.open().unwrap();
    let start = Instant::now();
    meter.poll(start).unwrap();
    for (zone, energy) in counts {
        tree.set(zone, *energy);
    }
    let later = start + Duration::from_secs(1);
    meter.poll(later).unwrap().remove(0)
}

fn joules(reading: &Reading, domain: Domain) -> Option<f64> {
    reading.value(domain)?.joules()
}

const CORE: &str = "intel-rapl:0/intel-rapl:0:0";
const SECOND: &str = "intel-rapl:0/intel-rapl:0:1";

#[test]
fn subzones_and_the_mmio_duplicate_are_not_added_to_the_package() {
    let tree = Tree::new(&[
        ("intel-rapl:0", "package-0", 1_000_000),
        (CORE, "core", 500_000),
        (SECOND, "uncore", 100_000),
        ("intel-rapl-mmio:0", "package-0", 1_000_000),
    ]);
    let counts = [
        ("intel-rapl:0", 31_000_000),
        ("intel-rapl-mmio:0", 31_000_000),
        (CORE, 20_500_000),
        (SECOND, 4_100_000),
    ];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(30.0));
    assert_eq!(joules(&reading, Domain::Gpu), Some(4.0));
    assert_eq!(joules(&reading, Domain::Cpu), Some(26.0));
    assert_eq!(joules(&reading, Domain::IoMem), None);
    assert_eq!(&*reading.total_from, "sum_of_rails");
    assert_eq!(reading.rails.len(), 3);
}

#[test]
fn two_sockets_and_their_memory_add_up() {
    let tree = Tree::new(&[
        ("intel-rapl:0", "package-0", 0),
        (CORE, "dram", 0),
        ("intel-rapl:1", "package-1", 0),
        ("intel-rapl:1/intel-rapl:1:0", "dram", 0),
    ]);
    let counts = [
        ("intel-rapl:0", 10_000_000),
        (CORE, 2_000_000),
        ("intel-rapl:1", 20_000_000),
        ("intel-rapl:1/intel-rapl:1:0", 3_000_000),
    ];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(35.0));
    assert_eq!(joules(&reading, Domain::Cpu), Some(30.0));
    assert_eq!(joules(&reading, Domain::IoMem), Some(5.0));
}

#[test]
fn psys_is_the_whole_platform_and_packages_are_not_added_to_it() {
    let tree = Tree::new(&[
        ("intel-rapl:0", "package-0", 0),
        ("intel-rapl:1", "psys", 0),
    ]);
    let counts = [("intel-rapl:0", 10_000_000), ("intel-rapl:1", 25_000_000)];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(25.0));
    assert_eq!(joules(&reading, Domain::Cpu), Some(10.0));
    assert_eq!(&*reading.total_from, "input_rail");
}

#[test]
fn a_counter_that_wraps_goes_on_counting() {
    let tree = Tree::new(&[("intel-rapl:0", "package-0", 262_143_328_850 - 4_000_000)]);
    let counts = [("intel-rapl:0", 6_000_000)];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(10.0));
}

#[test]
fn a_counter_that_was_reset_is_not_taken_for_one_that_wrapped() {
    let tree = Tree::new(&[("intel-rapl:0", "package-0", 5_000_000_000)]);
    let counts = [("intel-rapl:0", 1_000_000)];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(0.0));
}

#[test]
fn a_machine_without_powercap_says_what_was_looked_for() {
    let text = Tree::new(&[]).open().unwrap_err().to_string();
    assert!(
        text.contains("class/powercap") && text.contains("intel_rapl_msr"),
        "{text}"
    );
}

#[test]
fn only_the_mmio_zone_is_used_where_there_is_no_other() {
    let tree = Tree::new(&[("intel-rapl-mmio:0", "package-0", 0)]);
    let counts = [("intel-rapl-mmio:0", 3_000_000)];
    let reading = second_reading(&tree, &counts);
    assert_eq!(joules(&reading, Domain::Total), Some(3.0));
}

#[test]
fn a_psys_counter_that_counts_less_than_its_packages_is_not_believed() {
    let tree = Tree::new(&[
        ("intel-rapl:0", "package-0", 0),
        ("intel-rapl:1", "psys", 0),
    ]);
    let mut zones = find(&tree.0.path().join("class/powercap")).unwrap();
    let start = Instant::now();
    read(&mut zones, start).unwrap();
    tree.set("intel-rapl:0", 10_000_000);
    tree.set("intel-rapl:1", 150_000);
    read(&mut zones, start + Duration::from_secs(1)).unwrap();
    assert!(!includes_its_parts(&zones));
    tree.set("intel-rapl:1", 12_000_000);
    read(&mut zones, start + Duration::from_secs(2)).unwrap();
    assert!(includes_its_parts(&zones));
}
