//! The shipped energy models state their source.

use albireo_eval::energy_model::EnergyModel;
use std::path::Path;

#[test]
fn every_shipped_energy_model_states_its_source_and_its_error() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/energy");
    let mut boards = Vec::new();
    for file in std::fs::read_dir(folder).expect("the shipped models") {
        let path = file.expect("a file").path();
        let model = EnergyModel::load(&path).expect("a model that can be used");
        assert!(model.source.contains("commit "), "{model:?}");
        let missed = model.left_out.expect("it was tested on clips left out");
        assert!(missed.energy_percent > 0.0 && missed.energy_percent < 10.0);
        assert!((missed.saving_measured_percent - missed.saving_projected_percent).abs() < 2.0);
        // A frame without the detector costs less than one with it.
        assert!(model.energy_j.predicted < model.energy_j.detector / 2.0);
        assert!(model.energy_j.screen < model.energy_j.detector / 2.0);
        boards.push(model.board);
    }
    boards.sort();
    assert_eq!(boards, ["NVIDIA Jetson AGX Orin", "NVIDIA Jetson AGX Thor"]);
}
