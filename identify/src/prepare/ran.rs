//! What the pump has done since a run began: oil that warms by it remembers it for minutes.

use model::port::Ran;
use recordings::Recording;

/// Pieces are this long or of one voltage, s: far below any time in which a pump warms.
const PIECE_S: f64 = 1.0;

/// The pump's work from the run's start to row `end`, each row's voltage acting until the next one.
pub(super) fn ran(r: &Recording, end: usize) -> Vec<Ran> {
    let mut pieces: Vec<Ran> = Vec::new();
    for i in 0..end.min(r.len() - 1) {
        let (for_s, voltage_v) = (r.time_s[i + 1] - r.time_s[i], r.voltage_v[i].abs());
        match pieces.last_mut() {
            Some(piece) if piece.voltage_v == voltage_v => piece.for_s += for_s,
            Some(piece) if piece.for_s + for_s <= PIECE_S => {
                let whole_s = piece.for_s + for_s;
                let square = (piece.for_s * piece.voltage_v.powi(2) + for_s * voltage_v.powi(2)) / whole_s;
                *piece = Ran { for_s: whole_s, voltage_v: square.sqrt() };
            }
            _ => pieces.push(Ran { for_s, voltage_v }),
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_pump_has_done_is_told_in_few_pieces_with_all_its_time_and_all_its_squares() {
        let rows = 3_000;
        // 10 s at one voltage, 10 s that change in every row, 10 s off
        let voltage = |i: usize| match i {
            0..1_000 => -7.0,
            1_000..2_000 => 5.0 * (0.3 * i as f64).sin(),
            _ => 0.0,
        };
        let r = Recording {
            time_s: (0..rows).map(|i| i as f64 * 0.01).collect(),
            voltage_v: (0..rows).map(voltage).collect(),
            angle_deg: vec![0.0; rows],
            pressure1_bar: vec![2.0; rows],
            pressure2_bar: vec![2.0; rows],
            torque_nm: vec![f64::NAN; rows],
            volume_ml: vec![f64::NAN; rows],
            brake_open: vec![true; rows],
            bypass_open: vec![true; rows],
            segment: vec![0; rows],
        };
        assert!(ran(&r, 0).is_empty());
        for end in [400, 1_000, 1_730, 2_900] {
            let pieces = ran(&r, end);
            assert!(pieces.len() < 16, "{}", pieces.len());
            let time_s: f64 = pieces.iter().map(|p| p.for_s).sum();
            assert!((time_s - 0.01 * end as f64).abs() < 1e-9);
            let squares: f64 = pieces.iter().map(|p| p.for_s * p.voltage_v.powi(2)).sum();
            let all: f64 = (0..end).map(|i| 0.01 * voltage(i).powi(2)).sum();
            assert!((squares / all - 1.0).abs() < 1e-9, "{squares} {all}");
        }
    }
}
