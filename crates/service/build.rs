//! Sees to it that no release goes out without the pages, which `npm` builds from `web/` before.

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-env-changed=ALBIREO_WITHOUT_PAGES");
    if std::env::var("PROFILE").as_deref() != Ok("release") {
        // Other builds read the folder when they run: a change of a page costs them nothing.
        println!("cargo:rerun-if-changed=build.rs");
        return;
    }
    // The folder is always there, for its .gitignore is part of the clone.
    println!("cargo:rerun-if-changed=../../web/dist");
    let deliberate = std::env::var_os("ALBIREO_WITHOUT_PAGES").is_some();
    let is_built = |page: &str| Path::new("../../web/dist").join(page).exists();
    let built = is_built("node.html") && is_built("hub.html");
    if !deliberate && !built {
        eprintln!(
            "the pages are not built, and a release without them would show people nothing: run `make web` first \
             (it needs Node.js 20.19 or later with npm), or set ALBIREO_WITHOUT_PAGES=1 to build one deliberately \
             without, for example for a bench"
        );
        std::process::exit(1);
    }
}
