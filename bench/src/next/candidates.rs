//! The runs on offer, as scripts.
//!
//! They vary what rivals react to differently: how hard and how fast the lever is driven, how far, in which plane, at which filling,
//! with rests (brake open, closed, bypass open), slow ramps with reversals, steady holds, pulses of the valves, many frequencies at
//! once, and the bench experiments with fewer set points.

use identify::identification::Loaded;
use recordings::Protocol;
use rt_core::Limits;
use std::fmt::Write;

/// A run on offer.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// What it does, in a few words.
    pub about: String,
    /// Head of the script below the name: protocol, plane, start.
    head: String,
    /// Steps before what is repeated.
    lead: String,
    /// What is repeated; one pass.
    body: String,
    /// Passes of the shortest run.
    pub passes: usize,
    /// Whether more passes are of use.
    pub grows: bool,
    /// Time that people need before it, s: a plane to turn, a lever to clamp.
    pub preparation_s: f64,
}

impl Candidate {
    /// The script with this name and number of passes.
    pub fn script(&self, name: &str, passes: usize) -> String {
        let Candidate { about, head, lead, body, .. } = self;
        let mut text = format!("name = \"{name}\"\nrole = \"identify\"\nabout = \"{about}\"\n{head}{lead}");
        if self.grows {
            let deeper = |line: &str| match line {
                "[[step]]" => "[[step.step]]\n".to_owned(),
                "[step.random]" => "[step.step.random]\n".to_owned(),
                line => format!("{line}\n"),
            };
            let inner: String = body.lines().map(deeper).collect();
            let _ = write!(text, "[[step]]\nrepeat = {passes}\n{inner}");
        } else {
            text.push_str(body);
        }
        text
    }
}

/// What a candidate may do to the rig, and what the campaign did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// Angle at which strokes turn, degrees.
    pub turn_deg: f64,
    /// Filling of the campaign, bar absolute.
    pub fill_bar: f64,
    /// Lowest and highest filling on offer, bar absolute.
    pub fills_bar: (f64, f64),
}

/// Largest angle at which strokes turn, degrees, and their share of the rig's limit: a fast lever goes on for some degrees.
const TURN_DEG: f64 = 30.0;
const TURN_SHARE: f64 = 0.6;

impl Room {
    /// Of a rig with these limits, after this campaign.
    pub fn of(loaded: &Loaded, limits: &Limits) -> Room {
        let free = |p: Protocol| matches!(p, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps);
        let mut rests: Vec<f64> = loaded
            .runs
            .iter()
            .filter(|r| free(r.entry.protocol))
            .flat_map(|r| [r.recording.pressure1_bar.first(), r.recording.pressure2_bar.first()])
            .flatten()
            .copied()
            .filter(|p| p.is_finite())
            .collect();
        let middle = 0.5 * (limits.pressure_min_bar + limits.pressure_max_bar);
        let fill_bar = if rests.is_empty() { middle } else { identify::noise::median(&mut rests) };
        let within = |bar: f64| bar.clamp(1.15 * limits.pressure_min_bar, 0.7 * limits.pressure_max_bar);
        let fill_bar = within(fill_bar);
        let turn_deg = TURN_DEG.min(TURN_SHARE * limits.angle_max_deg);
        Room { turn_deg, fill_bar, fills_bar: (within(0.7 * fill_bar), within(1.4 * fill_bar)) }
    }
}

/// Time for the plane to be turned, and for a lever to be clamped or the pump to be taken to the bench, s.
const TURN_PLANE_S: f64 = 60.0;
const BENCH_S: f64 = 120.0;

fn head(protocol: &str, plane: &str, start: &str) -> String {
    format!("protocol = \"{protocol}\"\nplane = \"{plane}\"\n[start]\n{start}\n")
}

fn free_start(fill_bar: f64) -> String {
    format!("fixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = {fill_bar:.3}")
}

const REST: &str = "[[step]]\nfor_s = 1.2\n";

fn free(about: String, protocol: &str, plane: &str, fill_bar: f64, body: String, passes: usize) -> Candidate {
    Candidate {
        about,
        head: head(protocol, plane, &free_start(fill_bar)),
        lead: REST.into(),
        body,
        passes,
        grows: true,
        preparation_s: if plane == "vertical" { TURN_PLANE_S } else { 0.0 },
    }
}

/// A stroke to an angle or for a time.
fn stroke(share: f64, turn_deg: f64, timeout_s: f64) -> String {
    let side = if share > 0.0 { "above" } else { "below" };
    let angle = turn_deg * share.signum();
    format!(
        "[[step]]\nvoltage_u_max = {share:.3}\nbrake = \"open\"\nbypass = \"closed\"\nuntil = [{{ channel = \"angle_deg\", {side} = {angle:.2} }}]\ntimeout_s = {timeout_s}\n"
    )
}

fn rest(seconds: f64, brake: &str, bypass: &str) -> String {
    format!("[[step]]\nvoltage_v = 0.0\nbrake = \"{brake}\"\nbypass = \"{bypass}\"\nfor_s = {seconds}\n")
}

/// Everything on offer within this room.
pub fn candidates(room: &Room) -> Vec<Candidate> {
    let mut out = squares(room);
    out.extend(rests(room));
    out.extend(slow(room));
    out.extend(valves(room));
    out.extend(fast(room));
    out.extend(bench());
    out
}

fn squares(room: &Room) -> Vec<Candidate> {
    let Room { turn_deg, fill_bar, fills_bar } = *room;
    let wave = |share: f64, turn: f64, plane: &str, fill: f64| {
        let body = stroke(share, turn, 8.0) + &stroke(-share, turn, 8.0);
        let about =
            format!("square wave of {share} u_max to {turn:.0} deg either way, {plane}, filled to {fill:.1} bar");
        // one pass takes some 2 turn over the speed
        let passes = (6.0 * share * TURN_DEG / turn).round().clamp(2.0, 12.0) as usize;
        free(about, "square-wave", plane, fill, body, passes)
    };
    let mut out = Vec::new();
    for share in [0.25, 0.45, 0.7, 0.95] {
        for plane in ["horizontal", "vertical"] {
            out.push(wave(share, turn_deg, plane, fill_bar));
        }
    }
    out.push(wave(0.95, 0.4 * turn_deg, "horizontal", fill_bar));
    out.push(wave(0.25, 0.4 * turn_deg, "horizontal", fill_bar));
    for fill in [fills_bar.0, fills_bar.1] {
        out.push(wave(0.45, turn_deg, "horizontal", fill));
        out.push(wave(0.95, 0.7 * turn_deg, "horizontal", fill));
    }
    out
}

fn rests(room: &Room) -> Vec<Candidate> {
    let Room { turn_deg, fill_bar, fills_bar } = *room;
    let mut out = Vec::new();
    for (plane, brake, bypass, word, fill) in [
        ("horizontal", "open", "closed", "pump at rest", fill_bar),
        ("horizontal", "closed", "closed", "brake closed", fill_bar),
        ("horizontal", "closed", "open", "bypass open", fill_bar),
        ("vertical", "open", "closed", "pump at rest", fill_bar),
        ("vertical", "closed", "closed", "brake closed", fill_bar),
        ("vertical", "closed", "open", "bypass open", fill_bar),
        ("horizontal", "closed", "closed", "brake closed", fills_bar.0),
        ("horizontal", "closed", "closed", "brake closed", fills_bar.1),
        ("horizontal", "closed", "open", "bypass open", fills_bar.1),
    ] {
        let mut body = String::new();
        for (share, turn) in [(0.6, 0.9), (-0.6, 0.4), (0.35, 0.3), (-0.8, 0.9)] {
            body += &stroke(share, turn * turn_deg, 6.0);
            body += &rest(3.0, brake, bypass);
        }
        out.push(free(
            format!("strokes with rests of 3 s ({word}), {plane}, filled to {fill:.1} bar"),
            "random-steps",
            plane,
            fill,
            body,
            2,
        ));
    }
    out
}

fn slow(room: &Room) -> Vec<Candidate> {
    let Room { turn_deg, fill_bar, .. } = *room;
    let ramp = |to: f64, seconds: f64| {
        let (side, angle) = if to > 0.0 { ("above", turn_deg) } else { ("below", -turn_deg) };
        format!(
            "[[step]]\ntarget = {{ quantity = \"voltage_u_max\", wave = \"ramp\", from = 0.0, to = {to} }}\nuntil = [{{ channel = \"angle_deg\", {side} = {angle:.2} }}]\ntimeout_s = {seconds}\n"
        )
    };
    let mut out = Vec::new();
    for (to, seconds, plane) in
        [(0.3, 12.0, "horizontal"), (0.8, 5.0, "horizontal"), (0.3, 12.0, "vertical"), (0.8, 5.0, "vertical")]
    {
        out.push(free(
            format!("slow ramps to {to} u_max over {seconds} s with reversals, {plane}"),
            "random-steps",
            plane,
            fill_bar,
            ramp(to, seconds) + &ramp(-to, seconds),
            2,
        ));
    }
    for plane in ["horizontal", "vertical"] {
        let mut body = String::new();
        for share in [0.06, 0.1, -0.06, -0.1, 0.14, -0.14] {
            body += &stroke(share, turn_deg, 5.0);
        }
        out.push(free(
            format!("steady holds of 5 s at small voltages, {plane}"),
            "random-steps",
            plane,
            fill_bar,
            body,
            1,
        ));
    }
    out
}

fn valves(room: &Room) -> Vec<Candidate> {
    let Room { turn_deg, fill_bar, .. } = *room;
    let mut out = Vec::new();
    for (brake, bypass, word, shut_s) in
        [("closed", "closed", "brake", 0.12), ("closed", "closed", "brake", 0.5), ("open", "open", "bypass", 0.12)]
    {
        let mut body = String::new();
        for share in [0.7_f64, -0.7] {
            for part in [-0.5, 0.0, 0.5] {
                // a part of the way, then the pulse
                let to = part * turn_deg;
                let side = if share > 0.0 { "above" } else { "below" };
                let to = to * share.signum();
                let _ = write!(
                    body,
                    "[[step]]\nvoltage_u_max = {share}\nbrake = \"open\"\nbypass = \"closed\"\nuntil = [{{ channel = \"angle_deg\", {side} = {to:.2} }}]\ntimeout_s = 4.0\n[[step]]\nbrake = \"{brake}\"\nbypass = \"{bypass}\"\nfor_s = {shut_s}\n"
                );
            }
            body += &stroke(share, 0.9 * turn_deg, 4.0);
        }
        out.push(free(
            format!("strokes of 0.7 u_max with pulses of the {word} valve of {shut_s} s"),
            "random-steps",
            "horizontal",
            fill_bar,
            body,
            3,
        ));
    }
    out
}

fn fast(room: &Room) -> Vec<Candidate> {
    let Room { turn_deg, fill_bar, .. } = *room;
    let mut out = Vec::new();
    for (amplitude, band, plane) in
        [(0.8, "[0.1, 8.0]", "horizontal"), (0.5, "[0.5, 20.0]", "horizontal"), (0.8, "[0.1, 8.0]", "vertical")]
    {
        let body = format!(
            "[[step]]\ntarget = {{ quantity = \"voltage_u_max\", wave = \"multisine\", amplitude = {amplitude}, band_hz = {band}, period_s = 10.0 }}\nfor_s = 10.0\n"
        );
        out.push(free(
            format!("multisine of {amplitude} u_max, {band} Hz, {plane}"),
            "random-steps",
            plane,
            fill_bar,
            body,
            3,
        ));
    }
    for (plane, length, share) in [
        ("horizontal", "[0.05, 0.4]", 0.1),
        ("horizontal", "[0.2, 2.5]", 0.15),
        ("vertical", "[0.05, 0.4]", 0.1),
        ("vertical", "[0.2, 2.5]", 0.15),
    ] {
        let body = format!(
            "[[step]]\n[step.random]\ntotal_s = 30.0\nlength_s = {length}\nvoltage_u_max = [0.1, 0.97]\nzero_share = 0.1\nbrake_closed_share = {share}\nbypass_open_share = {share}\nguard_deg = {:.2}\n",
            0.85 * turn_deg
        );
        out.push(free(
            format!("random steps of {length} s with both valves, {plane}"),
            "random-steps",
            plane,
            fill_bar,
            body,
            1,
        ));
    }
    out
}

/// The paper's bench experiments with fewer set points.
fn bench() -> Vec<Candidate> {
    let fewer = |name: &str, about: &str, changes: &[(&str, &str)]| {
        let text = profiles::BUILTIN.iter().find(|(file, _)| *file == name)?.1;
        let mut text = changes.iter().fold(text.to_owned(), |t, (from, to)| t.replace(from, to));
        // name, role and about are this module's
        text = text
            .lines()
            .filter(|l| !["name =", "role =", "about =", "#"].iter().any(|key| l.starts_with(key)))
            .fold(String::new(), |t, l| t + l + "\n");
        let steps = text.find("[[step]]")?;
        let (head, body) = text.split_at(steps);
        Some(Candidate {
            about: about.into(),
            head: head.into(),
            lead: String::new(),
            body: body.into(),
            passes: 1,
            grows: false,
            preparation_s: BENCH_S,
        })
    };
    let angles = "[-40, -30, -20, -10, 0, 10, 20, 30, 40]";
    let all = [
        fewer("torque_map.toml", "torque map at three angles", &[(angles, "[-40, 0, 40]")]),
        fewer(
            "torque_map.toml",
            "torque map at three angles, vertical",
            &[(angles, "[-40, 0, 40]"), ("plane = \"horizontal\"", "plane = \"vertical\"")],
        ),
        fewer("clamp_steps.toml", "releases of oil at three angles", &[(angles, "[-40, 0, 40]")]),
        fewer(
            "pump_map.toml",
            "pump map at two loads and three voltages, both directions",
            &[
                ("[1.5, 2.7, 4.0, 5.3]", "[1.5, 4.5]"),
                ("[0.16, 0.23, 0.37, 0.55, 0.78, 1.0]", "[0.2, 0.5, 1.0]"),
                ("[-0.16, -0.23, -0.37, -0.55, -0.78, -1.0]", "[-0.2, -0.5, -1.0]"),
            ],
        ),
    ];
    all.into_iter().flatten().collect()
}
