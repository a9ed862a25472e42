//! Who may import whom. The crates are layers: a new arrow or a new crate is a decision, taken here and in README.md.

use cargo_metadata::{DependencyKind, MetadataCommand};
use std::collections::{BTreeMap, BTreeSet};

/// Crate and the crates of ours that it may import in the product. Tests and build scripts obey the same arrows.
const ARROWS: &[(&str, &[&str])] = &[
    ("model", &[]),
    ("rt-core", &[]),
    ("recordings", &["rt-core"]),
    ("profiles", &["rt-core"]),
    ("drivers", &["rt-core", "model"]),
    ("identify", &["model", "recordings"]),
    ("bench", &["model", "rt-core", "recordings", "profiles", "drivers", "identify"]),
    ("benchmarks", &["model", "rt-core", "recordings", "profiles", "drivers", "identify", "bench"]),
];

/// Where the product ends: what follows in the list only measures it.
const PRODUCT: &str = "bench";

/// Each workspace crate and the crates of ours that its manifest names, whatever the kind of dependency.
fn imports() -> BTreeMap<String, Vec<(String, DependencyKind)>> {
    let metadata = MetadataCommand::new()
        .manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"))
        .no_deps()
        .other_options(["--offline".to_owned()])
        .exec()
        .expect("cargo metadata works in the workspace that was just built");
    let ours: BTreeSet<String> = metadata.workspace_packages().iter().map(|p| p.name.to_string()).collect();
    metadata
        .workspace_packages()
        .iter()
        .map(|p| {
            let named = p.dependencies.iter().filter(|d| ours.contains(&d.name)).map(|d| (d.name.clone(), d.kind));
            (p.name.to_string(), named.collect())
        })
        .collect()
}

#[test]
fn the_list_of_crates_is_complete() {
    let listed: BTreeSet<String> = ARROWS.iter().map(|(name, _)| name.to_string()).collect();
    let found: BTreeSet<String> = imports().into_keys().collect();
    assert_eq!(found, listed, "crates of the workspace (left) and of ARROWS (right)");
}

#[test]
fn no_crate_imports_against_the_arrows() {
    for (name, found) in imports() {
        let allowed = ARROWS.iter().find(|(n, _)| *n == name).map(|(_, a)| *a).unwrap_or_default();
        for (dependency, kind) in found {
            assert!(
                allowed.contains(&dependency.as_str()),
                "{name} imports {dependency} ({kind:?} dependency); it may import {allowed:?}"
            );
        }
    }
}

#[test]
fn the_arrows_form_layers() {
    // Each crate imports only crates that stand above it in the list, so there is no cycle.
    for (i, (name, allowed)) in ARROWS.iter().enumerate() {
        for a in *allowed {
            assert!(ARROWS[..i].iter().any(|(n, _)| n == a), "{name} -> {a}");
        }
    }
}

#[test]
fn bench_is_where_all_meet() {
    let found: BTreeSet<String> =
        imports()["bench"].iter().filter(|(_, k)| *k == DependencyKind::Normal).map(|(n, _)| n.clone()).collect();
    let all: BTreeSet<String> = ARROWS.iter().map(|(n, _)| n.to_string()).take_while(|n| n != PRODUCT).collect();
    assert_eq!(found, all);
}
