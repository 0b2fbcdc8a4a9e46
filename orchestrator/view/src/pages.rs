//! The files of the page, which the executable contains.

use crate::http::Response;

/// Path, type and content.
const FILES: &[(&str, &str, &str)] = &[
    ("/", HTML, include_str!("page/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("page/page.css")),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("/main.js", SCRIPT, include_str!("page/main.js")),
    ("/link.js", SCRIPT, include_str!("page/link.js")),
    ("/stream.js", SCRIPT, include_str!("page/stream.js")),
    ("/worker.js", SCRIPT, include_str!("page/worker.js")),
    ("/map.js", SCRIPT, include_str!("page/map.js")),
    ("/bodies.js", SCRIPT, include_str!("page/bodies.js")),
    ("/camera.js", SCRIPT, include_str!("page/camera.js")),
    ("/loop.js", SCRIPT, include_str!("page/loop.js")),
    ("/latency.js", SCRIPT, include_str!("page/latency.js")),
    ("/charts.js", SCRIPT, include_str!("page/charts.js")),
    ("/past.js", SCRIPT, include_str!("page/past.js")),
    ("/player.js", SCRIPT, include_str!("page/player.js")),
    ("/timeline.js", SCRIPT, include_str!("page/timeline.js")),
    ("/panels.js", SCRIPT, include_str!("page/panels.js")),
    ("/control.js", SCRIPT, include_str!("page/control.js")),
];

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The file of that path.
pub(crate) fn file(path: &str) -> Option<Response> {
    let (_, content_type, content) = FILES.iter().find(|(known, ..)| *known == path)?;
    Some(Response::file(content_type, content.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_asks_for_nothing_that_is_not_in_it() {
        let is_known = |path: &str| FILES.iter().any(|(known, ..)| *known == path);
        for (name, _, content) in FILES {
            let foreign = content.replace("http://www.w3.org/2000/svg", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{name}");
            for after in ["src=\"", "href=\"", "from \".", "SharedWorker(\""] {
                for path in content.split(after).skip(1).filter_map(|rest| rest.split('"').next()) {
                    assert!(is_known(path), "{name} asks for {path}");
                }
            }
        }
        assert!(file("/../Cargo.toml").is_none());
    }

    #[test]
    fn the_page_is_small() {
        let bytes: usize = FILES.iter().map(|(.., content)| content.len()).sum();
        assert!(bytes < 120_000, "{bytes}");
    }
}
