//! Sees to it that no release goes out without the pages, which `npm` builds from `web/` before.

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-env-changed=ALBIREO_WITHOUT_PAGES");
    let built = ["node.html", "hub.html"]
        .iter()
        .all(|page| Path::new("../../web/dist").join(page).exists());
    let optimised = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    // Other builds read the folder when they run: a change of a page costs them nothing. It is always there, for its
    // .gitignore is part of the clone.
    let watched = if optimised {
        "../../web/dist"
    } else {
        "build.rs"
    };
    println!("cargo:rerun-if-changed={watched}");
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
