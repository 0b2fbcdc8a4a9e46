//! The result of a demo as one page without any other file.

use std::fmt::Write as _;

use super::claims::Claims;
use super::story::Story;

/// The page: the table, what happened, and the picture of the drive.
pub(super) fn html(claims: &Claims, story: &Story, picture: Option<&str>) -> String {
    let mut text = include_str!("demo.html").to_owned();
    let held = claims.claims.iter().filter(|claim| claim.held).count();
    let _ = writeln!(
        text,
        "<p class=\"{}\">{held} of {} promises held.</p>\n<table><thead><tr><th>promised</th><th></th><th>measured</th>\
         <th></th></tr></thead><tbody>",
        if claims.held { "held" } else { "failed" },
        claims.claims.len(),
    );
    for claim in &claims.claims {
        let (class, verdict) =
            if claim.held { ("held", "\u{2713} held") } else { ("failed", "\u{2717} not held") };
        let _ = writeln!(
            text,
            "<tr class=\"{class}\"><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td>{verdict}</td></tr>",
            escaped(claim.text),
            claim.promised_text().replace("<=", "at most").replace(">=", "at least"),
            escaped(&claim.measured_text()),
        );
    }
    text += "</tbody></table>\n<h2>What happened</h2>\n<table><tbody>\n";
    for (time_s, act, line) in &story.lines {
        // The link to the live page has a token, and leads nowhere elsewhere.
        if *act == "watch" {
            continue;
        }
        let _ = writeln!(
            text,
            "<tr><td class=\"number\">{time_s:.1} s</td><td>{}</td><td>{}</td></tr>",
            escaped(act),
            escaped(line)
        );
    }
    text += "</tbody></table>\n";
    if let Some(picture) = picture {
        let _ = writeln!(
            text,
            "<h2>The drive since its orchestrator was started</h2>\n<div class=\"picture\">{picture}</div>"
        );
    }
    let _ = writeln!(
        text,
        "<p class=\"small\">scanloop {}, {}, {}; <code>scanloop demo</code> repeats it.</p>\n</body></html>",
        env!("CARGO_PKG_VERSION"),
        figures::PROFILE,
        escaped(&machine()),
    );
    text
}

/// Kernel and processor of this machine.
fn machine() -> String {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let processors = read("/proc/cpuinfo");
    let models: Vec<&str> = processors.lines().filter_map(|line| line.strip_prefix("model name")).collect();
    let model =
        models.first().map_or("unknown processor", |model| model.trim_start_matches([' ', '\t', ':']));
    format!("{} x {model}, Linux {}", models.len().max(1), read("/proc/sys/kernel/osrelease").trim())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_one_file_and_keeps_the_token_of_the_live_page_to_itself() {
        let mut claims = Claims::new(|name| name == "clearance_m", &[]).unwrap();
        claims.measured("clearance_m", 0.25);
        let mut story = Story::new();
        story.tell("watch", "live page: http://127.0.0.1:1/#secret");
        story.tell("drive", "a < b");
        let page = html(&claims, &story, Some("<svg id=\"drive\"></svg>"));
        assert!(page.contains("0.25 m") && page.contains("a &lt; b") && page.contains("<svg id"), "{page}");
        assert!(page.contains("1 of 1 promises held"));
        for never in ["secret", "http://", "https://", "<script", "<link", "src="] {
            assert!(!page.contains(never), "{never}");
        }
    }
}
