//! Sees to it that no release goes out without the pages, which `npm` builds from `web/` before.

use std::path::Path;

fn main() {
    // The folder is always there: its .gitignore is part of the clone.
    println!("cargo:rerun-if-changed=../../web/dist");
    println!("cargo:rerun-if-env-changed=ALBIREO_WITHOUT_PAGES");
    let built = ["node.html", "hub.html"]
        .iter()
        .all(|page| Path::new("../../web/dist").join(page).exists());
    let optimised = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let deliberate = std::env::var_os("ALBIREO_WITHOUT_PAGES").is_some();
    if optimised && !built && !deliberate {
        eprintln!(
            "the pages are not built, and a release without them would show people nothing: run `make web` first \
             (it needs Node.js 20.19 or later with npm), or set ALBIREO_WITHOUT_PAGES=1 to build one deliberately \
             without, for example for a bench"
        );
        std::process::exit(1);
    }
}
