//! Parts of a simulated rig's file that tests share.

use parfocal::rig::Record;

/// The tables of its boards and axes.
pub fn boards_and_axes() -> String {
    let mut text = String::new();
    for (i, device) in ["scope", "m1", "m2"].into_iter().enumerate() {
        text += &format!("[boards.{device}]\nunique_id = \"50462d73696d2d626f61723{}\"\n", i + 1);
        for (index, coordinate) in ["x", "y", "z"].into_iter().enumerate() {
            text += &format!("[axes.{device}.{coordinate}]\nboard = \"{device}\"\nindex = {index}\n");
            if device == "scope" {
                text += "moves = \"objective\"\n";
            }
        }
    }
    text
}

/// How a calibration came about that no test asks about.
pub fn record() -> Record {
    Record {
        date: "2026-11-25T00:00:00Z".into(),
        seed: 1,
        samples: "memory".into(),
        tolerance_um: 1.0,
        rms_um: 0.1,
        residuals_um: Vec::new(),
        rejected: Vec::new(),
        certainty: None,
    }
}
