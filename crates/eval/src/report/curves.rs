//! Curves over training steps as SVG.

use std::{io::Write, path::Path};

use plotters::{coord::Shift, prelude::*};
use unopose_core::files::write_atomic;

use super::ReportError;

/// A line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub label: String,
    /// Position along the horizontal axis and value; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// Drawn thin and pale, as the unsmoothed background of another curve.
    pub faint: bool,
}

/// A plot with its own vertical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Caption above the plot.
    pub title: String,
    /// In the order of the legend, which gives them their colours.
    pub curves: Vec<Curve>,
    /// Fixed vertical range; without one it is that of the values.
    pub range: Option<(f64, f64)>,
}

const PANEL_SIZE: (u32, u32) = (860, 260);
/// Width of the plot; the names of the curves are on its right.
const PLOT_WIDTH: u32 = 700;

/// Writes the panels below each other with a common horizontal axis named `x_label`.
pub fn write_curves(path: &Path, x_label: &str, panels: &[Panel]) -> Result<(), ReportError> {
    let svg =
        render(x_label, panels).map_err(|message| ReportError::Draw { path: path.to_owned(), message })?;
    Ok(write_atomic(path, |writer| writer.write_all(svg.as_bytes()))?)
}

/// Means of `window` consecutive values, at the position of the last.
pub fn smoothed(points: &[(f64, f64)], window: usize) -> Vec<(f64, f64)> {
    let window = window.max(1);
    points
        .chunks(window)
        .filter_map(|chunk| {
            let mean = chunk.iter().map(|p| p.1).sum::<f64>() / chunk.len() as f64;
            chunk.last().map(|last| (last.0, mean))
        })
        .collect()
}

fn render(x_label: &str, panels: &[Panel]) -> Result<String, String> {
    let mut svg = String::new();
    {
        let size = (PANEL_SIZE.0, PANEL_SIZE.1 * panels.len().max(1) as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).map_err(|e| e.to_string())?;
        for (area, panel) in root.split_evenly((panels.len().max(1), 1)).iter().zip(panels) {
            draw(area, x_label, panel).map_err(|e| e.to_string())?;
        }
        root.present().map_err(|e| e.to_string())?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn draw(area: &Area<'_>, x_label: &str, panel: &Panel) -> Result<(), Box<dyn std::error::Error>> {
    let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
    let points = || panel.curves.iter().flat_map(|c| &c.points).filter(finite);
    let (mut x, mut y) = (bounds(points().map(|p| p.0)), bounds(points().map(|p| p.1)));
    y = panel.range.unwrap_or(y);
    (x, y) = (widened(x), widened(y));
    let (plot, legend) = area.split_horizontally(PLOT_WIDTH);
    let mut chart = ChartBuilder::on(&plot)
        .caption(&panel.title, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(56)
        .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
    chart.configure_mesh().x_desc(x_label).light_line_style(WHITE.mix(0.0)).draw()?;
    let line_height = (200 / panel.curves.len().max(1)).min(14) as i32;
    for (index, curve) in panel.curves.iter().enumerate() {
        let color = Palette99::pick(index).mix(if curve.faint { 0.4 } else { 1.0 });
        let style = color.stroke_width(if curve.faint { 1 } else { 2 });
        let drawn: Vec<(f64, f64)> = curve.points.iter().filter(finite).copied().collect();
        if drawn.len() < 60 && !curve.faint {
            chart.draw_series(drawn.iter().map(|&p| Circle::new(p, 3, color.filled())))?;
        }
        chart.draw_series(LineSeries::new(drawn, style))?;
        let y = 36 + line_height * index as i32;
        legend.draw(&PathElement::new([(0, y), (16, y)], style))?;
        legend.draw(&Text::new(curve.label.as_str(), (22, y - 6), ("sans-serif", 12)))?;
    }
    Ok(())
}

fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// A range that can be an axis: finite and not empty.
fn widened((low, high): (f64, f64)) -> (f64, f64) {
    match (low.is_finite() && high.is_finite(), high > low) {
        (false, _) => (0.0, 1.0),
        (true, false) => (low - 0.5, low + 0.5),
        (true, true) => (low, high),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<(f64, f64)>) -> Panel {
        let curve = Curve { label: "validation".into(), points, faint: false };
        Panel { title: "Loss".into(), curves: vec![curve], range: None }
    }

    #[test]
    fn values_land_where_the_axis_says() {
        let svg = render("step", &[panel(vec![(0.0, 10.0), (50.0, 5.0), (100.0, 0.0)])]).unwrap();
        assert!(svg.contains("Loss") && svg.contains("validation") && svg.contains("step"));
        let line = svg.split("<polyline").find(|part| part.contains("stroke-width=\"2\"")).unwrap();
        let line = line.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let points: Vec<(f64, f64)> = line
            .split_whitespace()
            .map(|p| p.split_once(',').map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).unwrap())
            .collect();
        let [first, middle, last] = points[..] else { panic!("{points:?}") };
        assert!(first.0 < middle.0 && middle.0 < last.0 && first.1 < middle.1 && middle.1 < last.1);
        assert!((middle.0 - (first.0 + last.0) / 2.0).abs() <= 1.0, "{points:?}");
        assert!((middle.1 - (first.1 + last.1) / 2.0).abs() <= 1.0, "{points:?}");
    }

    #[test]
    fn empty_single_and_non_finite_points_are_drawn_without_failure() {
        for points in [vec![], vec![(1.0, 2.0)], vec![(0.0, f64::NAN), (1.0, f64::INFINITY), (2.0, 1.0)]] {
            assert!(render("step", &[panel(points)]).unwrap().ends_with("</svg>\n"));
        }
    }

    #[test]
    fn smoothing_averages_windows_and_the_rest() {
        let points = [(1.0, 1.0), (2.0, 3.0), (3.0, 5.0), (4.0, 7.0), (5.0, 100.0)];
        assert_eq!(smoothed(&points, 2), [(2.0, 2.0), (4.0, 6.0), (5.0, 100.0)]);
        assert_eq!(smoothed(&points, 0).len(), 5);
    }
}
