//! docs/OWN_RIG.md: the rig file, the database and the profiles in it are what the program takes.
#![allow(clippy::unwrap_used, reason = "a test")]

mod guides;

const OWN_RIG: &str = include_str!("../../docs/OWN_RIG.md");

#[test]
fn what_can_be_followed_without_hardware_does_what_it_says() {
    let dir = tempfile::tempdir().unwrap();
    guides::follow(OWN_RIG, "docs/OWN_RIG.md", dir.path());
    // What is wired in the text is what the program reads: calibration and limits, not some default.
    let rig = bench::rig_file::Rig::read(Some(&dir.path().join("my_rig.toml"))).unwrap();
    assert_eq!((rig.limits.pressure_max_bar, rig.limits.angle_max_deg, rig.facts.u_max_v), (4.0, 40.0, 12.0));
    let understood = bench::rig_file::Understood::of(&rig).unwrap();
    let pressure = understood.mapping.iter().find(|m| m.key.contains("pressure1_bar")).unwrap();
    assert_eq!((pressure.gain, pressure.signal.as_str()), (Some(0.01), "Pressure1KPa"));
}
