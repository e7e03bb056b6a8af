use super::*;
use crate::tests::{Tree, assert_contains};

const PACKAGE: &str = "intel-rapl:0";
const FIRST: &str = "intel-rapl:0/intel-rapl:0:0";
const SECOND: &str = "intel-rapl:0/intel-rapl:0:1";
const OTHER: &str = "intel-rapl:1";
const DRAM: &str = "intel-rapl:1/intel-rapl:1:0";
const MMIO: &str = "intel-rapl-mmio:0";

/// Checks the joules of total, GPU, CPU and memory over 1 s. A zone has a path, a name, and its count before and after.
#[rstest::rstest]
#[case::subzones_and_the_mmio_duplicate_are_not_added_to_the_package(
    &[
        (PACKAGE, "package-0", 1_000_000, 31_000_000),
        (FIRST, "core", 500_000, 20_500_000),
        (SECOND, "uncore", 100_000, 4_100_000),
        (MMIO, "package-0", 1_000_000, 31_000_000),
    ],
    [Some(30.0), Some(4.0), Some(26.0), None],
    "processor",
)]
#[case::two_sockets_and_their_memory_add_up(
    &[
        (PACKAGE, "package-0", 0, 10_000_000),
        (FIRST, "dram", 0, 2_000_000),
        (OTHER, "package-1", 0, 20_000_000),
        (DRAM, "dram", 0, 3_000_000),
    ],
    [Some(35.0), None, Some(30.0), Some(5.0)],
    "processor + memory",
)]
#[case::packages_are_not_added_to_psys(
    &[(PACKAGE, "package-0", 0, 10_000_000), (OTHER, "psys", 0, 25_000_000)],
    [Some(25.0), None, Some(10.0), None],
    "platform (psys)",
)]
#[case::the_mmio_zone_is_used_if_it_is_the_only_one(
    &[(MMIO, "package-0", 0, 3_000_000)],
    [Some(3.0), None, Some(3.0), None],
    "processor",
)]
#[case::counting_continues_across_a_wrap(
    &[(PACKAGE, "package-0", 262_143_328_850 - 4_000_000, 6_000_000)],
    [Some(10.0), None, Some(10.0), None],
    "processor",
)]
fn energy_per_domain(
    #[case] zones: &[(&str, &str, u64, u64)],
    #[case] joules: [Option<f64>; 4],
    #[case] total_from: &str,
) {
    let tree = Tree::default();
    for (zone, name, before, _) in zones {
        tree.rapl(zone, name, *before);
    }
    let mut meter = Rapl::open(&tree.config()).unwrap();
    let start = Instant::now();
    meter.poll(start).unwrap();
    for (zone, name, _, after) in zones {
        tree.rapl(zone, name, *after);
    }
    let later = start + Duration::from_secs(1);
    let reading = meter.poll(later).unwrap().remove(0);
    let [total, gpu, cpu, io_mem] = joules.map(|joules| joules.map(Value::Counter));
    let expected = PerDomain {
        total,
        gpu,
        cpu,
        io_mem,
    };
    assert_eq!(reading.values, expected);
    assert_eq!(&*reading.total_from, total_from);
}

#[test]
fn missing_powercap_is_an_error_that_names_folder_and_module() {
    let error = Rapl::open(&Tree::default().config()).unwrap_err();
    assert_contains(error, &["class/powercap", "intel_rapl_msr"]);
}

#[test]
fn a_psys_counter_below_its_packages_is_not_trusted() {
    let tree = Tree::default();
    tree.rapl(PACKAGE, "package-0", 0);
    tree.rapl(OTHER, "psys", 0);
    let mut zones = find(&tree.path("sys/class/powercap")).unwrap();
    let start = Instant::now();
    read(&mut zones, start).unwrap();
    for (second, psys, believed) in [(1, 150_000, false), (2, 12_000_000, true)] {
        tree.rapl(PACKAGE, "package-0", 10_000_000);
        tree.rapl(OTHER, "psys", psys);
        read(&mut zones, start + Duration::from_secs(second)).unwrap();
        assert_eq!(includes_its_parts(&zones), believed);
    }
    for (whole, total) in [(Whole::Packages, 10.0), (Whole::Platform, 12.0)] {
        let mut meter = Rapl {
            zones,
            whole,
            cards: 0,
        };
        let found = meter.poll(start + Duration::from_secs(3)).unwrap()[0].value(Domain::Total);
        assert_eq!(found, Some(Value::Counter(total)));
        zones = meter.zones;
    }
}

#[rstest::rstest]
#[case::memory_without_a_count(FIRST, "dram", "energy_uj")]
#[case::memory_without_a_name(FIRST, "dram", "name")]
#[case::core_without_a_range(SECOND, "core", "max_energy_range_uj")]
#[case::platform_without_a_count(OTHER, "psys", "energy_uj")]
fn an_odd_zone_is_left_out_and_the_package_is_read(
    #[case] zone: &str,
    #[case] name: &str,
    #[case] missing: &str,
) {
    let tree = Tree::default();
    tree.rapl(PACKAGE, "package-0", 0);
    tree.rapl(zone, name, 0);
    std::fs::remove_file(tree.path(format!("sys/class/powercap/{zone}/{missing}"))).unwrap();
    let mut meter = Rapl::open(&tree.config()).unwrap();
    let start = Instant::now();
    meter.poll(start).unwrap();
    tree.rapl(PACKAGE, "package-0", 12_000_000);
    let reading = meter.poll(start + Duration::from_secs(1)).unwrap().remove(0);
    assert_eq!(reading.value(Domain::Total), Some(Value::Counter(12.0)));
}

#[test]
fn a_package_that_cannot_be_read_is_an_error_for_the_total_would_be_too_small() {
    let tree = Tree::default();
    tree.rapl(PACKAGE, "package-0", 0);
    tree.rapl(OTHER, "package-1", 0);
    std::fs::remove_file(tree.path(format!("sys/class/powercap/{OTHER}/energy_uj"))).unwrap();
    let error = Rapl::open(&tree.config()).unwrap_err();
    assert_contains(error, &["intel-rapl:1/energy_uj"]);
}
