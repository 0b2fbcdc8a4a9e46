//! The files of the page, which the executable contains.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

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
    ("/why.js", SCRIPT, include_str!("page/why.js")),
];

/// Scripts that only a page of a server needs.
const ONLINE: [&str; 2] = ["/stream.js", "/worker.js"];
/// Where the page names its style and its first script.
const STYLE: &str = r#"<link rel="stylesheet" href="/page.css">"#;
const MAIN: &str = r#"<script type="module" src="/main.js"></script>"#;
/// Two drives compared: a page that is only ever a file.
const COMPARE: &str = include_str!("page/compare.html");
const COMPARE_SCRIPT: &str = include_str!("page/compare.js");
/// What stands for `link.js` in a page that is a file.
const ENCLOSED: &str = include_str!("page/enclosed.js");

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The file of that path.
pub(crate) fn file(path: &str) -> Option<Response> {
    let (_, content_type, content) = FILES.iter().find(|(known, ..)| *known == path)?;
    Some(Response::file(content_type, content.as_bytes()))
}

/// The page as one file, with a drive in it as `enclosed.js` reads it. A script imports others by their names, which an import
/// map leads to their texts.
pub(crate) fn enclosed(drive: &str) -> String {
    let scripts = FILES.iter().filter(|(path, kind, _)| *kind == SCRIPT && !ONLINE.contains(path));
    let text = |path: &str, text| if path == "/link.js" { ENCLOSED } else { text };
    whole(text_of("/"), scripts.map(|(path, _, content)| (&path[1..], text(path, content))), drive)
}

/// The page of two drives compared as one file, with them in it.
pub(crate) fn compared(drives: &str) -> String {
    let own = [("main.js", COMPARE_SCRIPT), ("link.js", ENCLOSED)];
    let shared = ["charts.js", "latency.js"].map(|name| (name, text_of(&format!("/{name}"))));
    whole(COMPARE, own.into_iter().chain(shared), drives)
}

fn text_of(path: &str) -> &'static str {
    FILES.iter().find(|(known, ..)| *known == path).map_or("", |(.., text)| text)
}

fn whole<'a>(page: &str, scripts: impl Iterator<Item = (&'a str, &'a str)>, content: &str) -> String {
    let as_url = |kind: &str, text: &str| format!("data:{kind};base64,{}", STANDARD.encode(text));
    let imports: serde_json::Map<String, serde_json::Value> = scripts
        .map(|(name, text)| {
            (name.to_owned(), as_url("text/javascript", &text.replace("from \"./", "from \"")).into())
        })
        .collect();
    let map = serde_json::json!({ "imports": imports });
    let script = format!(
        "<script type=\"importmap\">{map}</script>\n<script type=\"module\">import \"main.js\";</script>"
    );
    let page = page
        .replace("/icon.svg", &as_url("image/svg+xml", text_of("/icon.svg")))
        .replace(STYLE, &format!("<style>\n{}</style>", text_of("/page.css")))
        .replace(MAIN, &script);
    page.replace("</body>", &format!("<script type=\"text/plain\" id=\"drive\">{content}</script>\n</body>"))
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
    fn the_page_of_compared_drives_asks_for_nothing_at_all() {
        let page = compared("abc");
        assert!(page.contains("id=\"drive\">abc</script>") && page.len() < 60_000, "{}", page.len());
        for after in ["src=\"", "href=\""] {
            assert!(page.split(after).skip(1).all(|rest| rest.starts_with("data:")), "{page}");
        }
        let names = COMPARE_SCRIPT.split("from \"./").skip(1).filter_map(|rest| rest.split('"').next());
        assert_eq!(names.collect::<Vec<_>>(), ["charts.js", "latency.js", "link.js"]);
    }

    #[test]
    fn the_page_is_small() {
        let bytes: usize = FILES.iter().map(|(.., content)| content.len()).sum();
        assert!(bytes < 120_000, "{bytes}");
    }
}
