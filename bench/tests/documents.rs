//! Documents that describe what the code holds must hold what the code does.

use model::effects::LIBRARY;
use std::path::Path;

const CAMPAIGN: &str = include_str!("../../docs/CAMPAIGN.md");
const README: &str = include_str!("../../README.md");

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Text of a fenced block of this language, the first one that holds `word`.
fn fenced(language: &str, word: &str) -> String {
    CAMPAIGN
        .split(&format!("```{language}\n"))
        .skip(1)
        .filter_map(|block| block.split("```").next())
        .find(|block| block.contains(word))
        .unwrap_or_else(|| panic!("no {language} block with {word:?} in docs/CAMPAIGN.md"))
        .to_owned()
}

#[test]
fn every_effect_of_the_library_is_listed_once_with_its_balance_and_nothing_else() {
    let section = CAMPAIGN.split("## Effects").nth(1).expect("the section is there");
    let (table, forms) = section.split_once("| id | further parameters |").expect("the table of general forms");
    let rows = |text: &'static str| -> Vec<&str> {
        text.lines().filter(|line| line.starts_with("| ") && line.contains('`')).collect()
    };
    let listed = rows(table);
    assert_eq!(listed.len(), LIBRARY.len());
    for effect in LIBRARY {
        let h = effect.header();
        let row = format!("| {} | `{}` | {} |", h.balance.as_str(), h.id, h.summary);
        assert_eq!(listed.iter().filter(|line| **line == row).count(), 1, "docs/CAMPAIGN.md lacks: {row}");
        assert!(root().join(format!("model/src/effects/{}.rs", h.id)).is_file(), "the document names this file");
        let row = rows(forms).into_iter().find(|line| line.contains(&format!("`{}`", h.id)));
        let own = effect.refined().map_or(&[][..], |r| &r.effect.header().parameters[h.parameters.len()..]);
        assert_eq!(row.is_some(), !own.is_empty(), "{}: a general form and its row", h.id);
        assert!(own.iter().all(|p| row.is_some_and(|r| r.contains(&format!("`{}`", p.name)))), "{row:?}");
    }
}

#[test]
fn the_model_in_the_document_is_one_that_is_read() {
    let text = fenced("toml", "[torque]");
    model::ModelFile::parse(&text, "docs/CAMPAIGN.md").expect("the documented model");
    for name in model::parameters::NAMES {
        assert!(CAMPAIGN.contains(&format!("`{name}`")) || text.contains(&format!("\n{name} = ")), "{name}");
    }
}

#[test]
fn the_campaign_in_the_document_is_one_that_is_read() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(dir.path().join("campaign.toml"), fenced("toml", "[[run]]")).expect("writable");
    std::fs::write(dir.path().join("square_h.mcap"), b"").expect("writable");
    let campaign = recordings::Campaign::open(dir.path()).expect("the documented campaign");
    assert_eq!(campaign.runs.len(), 1);
    for protocol in recordings::Protocol::ALL {
        assert!(CAMPAIGN.contains(&format!("| `{protocol}` |")), "{protocol} is not in docs/CAMPAIGN.md");
    }
}

#[test]
fn links_and_files_that_the_documents_name_exist() {
    let document = |name: &str| std::fs::read_to_string(root().join("docs").join(name)).expect("a document");
    let guides = [
        "TUTORIAL.md",
        "OWN_RIG.md",
        "SCRIPTS.md",
        "NETWORK.md",
        "WIRES.md",
        "PROFILES.md",
        "RUNNING.md",
        "RECORDINGS.md",
        "DIAGNOSIS.md",
        "PLANTS.md",
        "CLIENTS.md",
    ]
    .map(document);
    let guides = guides.iter().map(|text| ("docs", text.as_str()));
    for (folder, text) in [("", README), ("docs", CAMPAIGN)].into_iter().chain(guides) {
        let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for link in links.filter(|link| !link.starts_with("http")) {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let path = root().join(folder).join(file);
            assert!(path.exists(), "{link} in {folder}/ does not exist");
            if !heading.is_empty() {
                // A link within the document names no file.
                let read = || std::fs::read_to_string(&path).expect("a document");
                let text = if file.is_empty() { text.to_owned() } else { read() };
                // As the hosts of such files make it: punctuation goes.
                let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
                let slug = |line: &str| line.to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-");
                let named = |line: &str| slug(line.trim_start_matches('#').trim()) == heading;
                assert!(
                    text.lines().any(|line| line.starts_with('#') && named(line)),
                    "{link} in {folder}/: no heading"
                );
            }
        }
    }
}
