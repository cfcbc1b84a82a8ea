//! Markers and boards to print, as SVG in millimetres.

use super::board::Board;
use super::marker::{BORDER_CELLS, CELLS, cells};
use super::{CoarseError, MarkerId};
use std::fmt::Write;

/// An A4 sheet, mm.
const PAGE: (f64, f64) = (210.0, 297.0);
const MARGIN_MM: f64 = 12.0;

/// A sheet of markers, each with its number and a cutting line around its white margin.
///
/// # Errors
/// [`CoarseError::NoSuchMarker`], and [`CoarseError::BadSize`] when not even one marker fits on the page.
pub fn markers(ids: &[MarkerId], size_mm: f64) -> Result<String, CoarseError> {
    let cell = size_mm / BORDER_CELLS as f64;
    let side = cell * CELLS as f64;
    let (across, down) = (side + 6.0, side + 9.0);
    let columns = ((PAGE.0 - 2.0 * MARGIN_MM) / across).floor();
    if !(size_mm > 1.0 && columns >= 1.0) {
        return Err(CoarseError::BadSize(size_mm));
    }
    let mut body = String::new();
    for (k, id) in ids.iter().enumerate() {
        let (column, row) = ((k as f64) % columns, (k as f64 / columns).floor());
        let (x, y) = (MARGIN_MM + column * across, MARGIN_MM + 12.0 + row * down);
        let _ = write!(
            body,
            "<rect x='{x:.3}' y='{y:.3}' width='{side:.3}' height='{side:.3}' fill='#fff' stroke='#bbb' stroke-width='0.1'/>"
        );
        body += &marker(*id, x + cell, y + cell, size_mm)?;
        let _ = writeln!(body, "<text x='{x:.3}' y='{:.3}' font-size='3'>{id}</text>", y + side + 3.5);
    }
    let rows = (ids.len() as f64 / columns).ceil();
    let note = format!("tag36h11, black border {size_mm} mm: print at 100 %, then measure the bar below: 100 mm");
    Ok(page(&note, &body, PAGE.1.max(MARGIN_MM + 24.0 + rows * down)))
}

/// A board for the calibration of a stereo camera.
///
/// # Errors
/// [`CoarseError::NoSuchMarker`] when the board needs ids beyond the family's.
pub fn board(board: &Board) -> Result<String, CoarseError> {
    let mut body = String::new();
    for (id, centre) in board.markers() {
        let h = board.tag_mm / 2.0;
        body += &marker(id, MARGIN_MM + h + centre.x, MARGIN_MM + 14.0 + h + centre.y, board.tag_mm)?;
    }
    let note = format!(
        "{} x {} markers from {}, {} mm, {} mm apart: print at 100 %, glue on glass, measure the bar: 100 mm",
        board.columns, board.rows, board.first.0, board.tag_mm, board.gap_mm
    );
    let bottom = f64::from(board.rows) * (board.tag_mm + board.gap_mm);
    Ok(page(&note, &body, PAGE.1.max(bottom + 2.0 * MARGIN_MM + 14.0)))
}

/// The black squares of a marker whose border's top left corner is at (x, y), mm.
fn marker(id: MarkerId, x: f64, y: f64, size_mm: f64) -> Result<String, CoarseError> {
    let cells = cells(id).ok_or(CoarseError::NoSuchMarker(id))?;
    let cell = size_mm / BORDER_CELLS as f64;
    // One path in whole squares: no hairlines of paper between neighbours.
    let mut path = String::new();
    for (row, line) in cells[1..=BORDER_CELLS].iter().enumerate() {
        let mut column = 0;
        while column < BORDER_CELLS {
            let run = line[column + 1..=BORDER_CELLS].iter().take_while(|white| !**white).count();
            if run > 0 {
                let _ = write!(path, "M{column} {row}h{run}v1h-{run}z");
            }
            column += run + 1;
        }
    }
    Ok(format!(
        "<path transform='translate({x:.4} {y:.4}) scale({cell:.6})' d='{path}' fill='#000' shape-rendering='crispEdges'/>\n"
    ))
}

fn page(note: &str, body: &str, height: f64) -> String {
    let width = PAGE.0;
    format!(
        "<svg xmlns='http://www.w3.org/2000/svg' width='{width}mm' height='{height:.1}mm' viewBox='0 0 {width} {height:.1}' \
         font-family='sans-serif'>\n<rect width='100%' height='100%' fill='#fff'/>\n\
         <text x='{MARGIN_MM}' y='{MARGIN_MM}' font-size='3.5'>{note}</text>\n\
         <path d='M{MARGIN_MM} {y}h100' stroke='#000' stroke-width='0.4'/>\n{body}</svg>\n",
        y = MARGIN_MM + 4.0
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_holds_every_square_of_its_markers() {
        let svg = markers(&[MarkerId(0), MarkerId(7)], 20.0).unwrap();
        let black = cells(MarkerId(7)).unwrap()[1..9].iter().flat_map(|r| &r[1..9]).filter(|w| !**w).count();
        let path = svg.lines().filter(|l| l.contains("<path transform")).nth(1).unwrap();
        let painted: usize = path
            .split('h')
            .skip(1)
            .filter_map(|part| part.split('v').next().and_then(|n| n.parse::<usize>().ok()))
            .sum();
        assert_eq!(painted, black);
        assert!(svg.contains("scale(2.500000)") && svg.contains("width='210mm'"));
    }

    #[test]
    fn a_marker_larger_than_the_page_is_refused() {
        assert!(matches!(markers(&[MarkerId(0)], 300.0), Err(CoarseError::BadSize(_))));
        assert!(matches!(markers(&[MarkerId(600)], 20.0), Err(CoarseError::NoSuchMarker(_))));
    }
}
