//! BOP result tables: `scene_id,im_id,obj_id,score,R,t,time`, one estimated pose per line.

use std::{collections::HashMap, io::Write, path::Path};

use unopose_core::{files::write_atomic, geometry::Pose};

use super::FormatError;

const HEADER: [&str; 7] = ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"];
const MM_PER_METRE: f64 = 1000.0;
/// Stands in the table for a time that nobody took.
const UNKNOWN_TIME: f64 = -1.0;
/// No camera sees farther, metres; larger numbers overflow when they are squared.
const FARTHEST: f64 = 1e9;

/// One estimated pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseResult {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Object whose pose it is.
    pub obj_id: u32,
    /// Ranks the estimates of an image.
    pub score: f64,
    /// Object to camera, metres.
    pub t_camera_object: Pose,
    /// Seconds for the whole image, segmentation included; -1 when unknown.
    pub time: f64,
}

/// The name `METHOD_DATASET-SPLIT.csv` that BOP expects. Underscores in the method become dashes, they would end it.
pub fn result_file_name(method: &str, dataset: &str, split: &str) -> String {
    format!("{}_{dataset}-{split}.csv", method.replace('_', "-"))
}

/// Reads a result table with or without its header line; a missing `time` column counts as unknown. An error when it has
/// no pose.
pub fn read_results(path: &Path) -> Result<Vec<PoseResult>, FormatError> {
    // A pipe may block and a device may have no end.
    let kind = std::fs::metadata(path).map_err(|e| FormatError::io(path, e))?.file_type();
    if !kind.is_file() {
        let kind = if kind.is_dir() { "a folder" } else { "a pipe, socket or device" };
        return Err(FormatError::field(path.display(), "result table", kind, "a regular file"));
    }
    let file = std::fs::File::open(path).map_err(|e| FormatError::io(path, e))?;
    let csv_error = |source| FormatError::Csv { path: path.to_path_buf(), source };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        // Counts the lines of Windows right, too: the trimming takes the rest of their ends.
        .terminator(csv::Terminator::Any(b'\n'))
        .trim(csv::Trim::All)
        .from_reader(std::io::BufReader::new(file));
    let mut results = Vec::new();
    let mut seen = SeenLines::default();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(csv_error)?;
        if record.len() == 1 && record[0].is_empty() {
            continue;
        }
        let line = record.position().map_or(index as u64 + 1, |p| p.line());
        let place = format!("{}: line {line}", path.display());
        let first = record.get(0).unwrap_or_default().trim_start_matches('\u{feff}');
        if results.is_empty() && first == HEADER[0] {
            if !record.iter().skip(1).eq(HEADER[1..record.len().min(HEADER.len())].iter().copied()) {
                let met = record.iter().collect::<Vec<_>>().join(",");
                return Err(FormatError::field(place, "header", met, HEADER.join(",")));
            }
            continue;
        }
        let result = parse_line(&record, &place)?;
        seen.check(&result, line, &place)?;
        results.push(result);
    }
    if results.is_empty() {
        return Err(FormatError::field(
            path.display(),
            "result table",
            "without a pose",
            "at least one line",
        ));
    }
    Ok(results)
}

/// What later lines have to agree with, with line numbers.
#[derive(Default)]
struct SeenLines {
    /// Time of an image.
    times: HashMap<(u32, u32), (f64, u64)>,
    /// Poses by their bits.
    poses: HashMap<([u32; 3], [u64; 13]), u64>,
}

impl SeenLines {
    /// An estimate is there once, and all lines of an image have its time.
    fn check(&mut self, result: &PoseResult, line: u64, place: &str) -> Result<(), FormatError> {
        let PoseResult { scene_id, im_id, obj_id, score, t_camera_object: pose, time } = result;
        let (time_then, first) = *self.times.entry((*scene_id, *im_id)).or_insert((*time, line));
        // The toolkit's tolerance.
        if (time_then - time).abs() > 1e-3 {
            let expected = format!("{time_then} as in line {first}: the time is the image's");
            return Err(FormatError::field(place, "time", time, expected));
        }
        let numbers = pose.rotation.iter().chain(&pose.translation).chain([score]).map(|x| x.to_bits());
        let mut bits = [0; 13];
        bits.iter_mut().zip(numbers).for_each(|(bits, number)| *bits = number);
        match self.poses.insert(([*scene_id, *im_id, *obj_id], bits), line) {
            Some(first) => {
                let expected = format!("another pose or score than in line {first}");
                Err(FormatError::field(place, "line", "a repetition", expected))
            }
            None => Ok(()),
        }
    }
}

fn parse_line(record: &csv::StringRecord, place: &str) -> Result<PoseResult, FormatError> {
    if !(6..=7).contains(&record.len()) {
        let fields = format!("{} fields", record.len());
        return Err(FormatError::field(place, "line", fields, format!("7: {}", HEADER.join(","))));
    }
    let wrong = |column: usize, expected: &str| {
        let met = if record[column].is_empty() { "empty" } else { &record[column] };
        FormatError::field(place, HEADER[column], met, expected)
    };
    let id = |column: usize| {
        record[column]
            .trim_start_matches('\u{feff}')
            .parse::<u32>()
            .map_err(|_| wrong(column, "a non-negative integer"))
    };
    let finite = |text: &str| text.parse::<f64>().ok().filter(|v| v.is_finite());
    fn numbers<const N: usize>(text: &str, finite: impl Fn(&str) -> Option<f64>) -> Option<[f64; N]> {
        let values: Option<Vec<f64>> = text.split_whitespace().map(finite).collect();
        values?.try_into().ok()
    }
    let r =
        numbers::<9>(&record[4], finite).ok_or_else(|| wrong(4, "9 finite numbers separated by spaces"))?;
    let t =
        numbers::<3>(&record[5], finite).ok_or_else(|| wrong(5, "3 finite numbers separated by spaces"))?;
    if t.iter().any(|mm| mm.abs() > FARTHEST * MM_PER_METRE) {
        return Err(wrong(5, "millimetres"));
    }
    let t_camera_object = Pose::from_row_major(&r, &t.map(|mm| mm / MM_PER_METRE));
    // Written with few digits by some methods.
    if t_camera_object.rotation_defect() > 1e-2 {
        return Err(wrong(4, "a rotation matrix, row-major"));
    }
    let time = match record.get(6) {
        Some(text) => {
            let time = finite(text).filter(|&time| time >= 0.0 || time == UNKNOWN_TIME);
            time.ok_or_else(|| wrong(6, "seconds, -1 when unknown"))?
        }
        None => UNKNOWN_TIME,
    };
    Ok(PoseResult {
        scene_id: id(0)?,
        im_id: id(1)?,
        obj_id: id(2)?,
        score: finite(&record[3]).ok_or_else(|| wrong(3, "a finite number"))?,
        t_camera_object,
        time,
    })
}

/// Writes a result table with its header, atomically.
pub fn write_results(path: &Path, results: &[PoseResult]) -> Result<(), FormatError> {
    let joined = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let written = write_atomic(path, |writer| {
        writeln!(writer, "{}", HEADER.join(","))?;
        for result in results {
            let pose = &result.t_camera_object;
            let (r, t) = (joined(&pose.rotation_row_major()), pose.translation * MM_PER_METRE);
            let (t, PoseResult { scene_id, im_id, obj_id, score, time, .. }) = (joined(t.as_slice()), result);
            writeln!(writer, "{scene_id},{im_id},{obj_id},{score},{r},{t},{time}")?;
        }
        Ok(())
    });
    Ok(written?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<PoseResult>, FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m_d-test.csv");
        std::fs::write(&path, text).unwrap();
        read_results(&path)
    }

    const LINE: &str = "1,0,3,0.5,1 0 0 0 0 -1 0 1 0,10.5 -20 700,-1";

    #[test]
    fn with_and_without_header_and_time() {
        let expected = PoseResult {
            scene_id: 1,
            im_id: 0,
            obj_id: 3,
            score: 0.5,
            t_camera_object: Pose::from_row_major(
                &[1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
                &[0.0105, -0.02, 0.7],
            ),
            time: -1.0,
        };
        let header = HEADER.join(",");
        let without_time = LINE.strip_suffix(",-1").unwrap();
        for text in [LINE.to_owned(), format!("{header}\r\n{LINE}\r\n"), without_time.to_owned()] {
            assert_eq!(read(&text).unwrap(), [expected], "{text}");
        }
        let bom = format!("\u{feff}{header}\r\n{LINE}");
        assert_eq!(read(&bom).unwrap(), [expected]);
        assert_eq!(read(&format!("\u{feff}{LINE}\r\n\r\n")).unwrap(), [expected]);
    }

    #[test]
    fn a_table_without_poses_and_a_file_without_end_are_refused() {
        for text in ["", "\n", "scene_id,im_id,obj_id,score,R,t,time\n"] {
            let message = read(text).unwrap_err().to_string();
            assert!(
                message.ends_with("result table is without a pose, expected at least one line"),
                "{message}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let message = read_results(folder.path()).unwrap_err().to_string();
        assert!(message.contains("result table is a folder, expected a regular file"), "{message}");
        #[cfg(unix)]
        {
            let message = read_results(Path::new("/dev/zero")).unwrap_err().to_string();
            assert!(message.contains("/dev/zero: result table is a pipe, socket or device"), "{message}");
        }
    }

    #[test]
    fn what_is_written_is_read_back_to_the_last_bit_of_the_rotation() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("results.csv");
        let mut results = read(LINE).unwrap();
        results[0].t_camera_object.rotation =
            *nalgebra::Rotation3::from_euler_angles(0.1, 0.2, 1.0 / 3.0).matrix();
        results[0].time = 0.25;
        write_results(&path, &results).unwrap();
        let read = read_results(&path).unwrap();
        assert_eq!(read[0].t_camera_object.rotation, results[0].t_camera_object.rotation);
        assert!(read[0].t_camera_object.translation_distance(&results[0].t_camera_object) < 1e-15);
        assert_eq!((read[0].time, read[0].score), (0.25, 0.5));
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, part) in [
            (format!("{LINE}\n1,0,3,0.5,1 0 0,10 20 700,-1"), "line 2: R is 1 0 0"),
            ("1,0,3,nan,1 0 0 0 1 0 0 0 1,0 0 700,-1".into(), "score is nan"),
            ("1,x,3,1,1 0 0 0 1 0 0 0 1,0 0 700,-1".into(), "im_id is x"),
            ("1,0,3,1,1 0 0 0 1 0 0 0 1,0 inf 700,-1".into(), "t is 0 inf 700"),
            ("1,0,3".into(), "3 fields"),
            (format!("{LINE},7"), "line 1: line is 8 fields, expected 7"),
            (
                "1,0,3,,1 0 0 0 1 0 0 0 1,0 0 700,-1".into(),
                "line 1: score is empty, expected a finite number",
            ),
            ("1,0,3,1,1 0 0 0 1 0 0 0 nan,0 0 700,-1".into(), "R is 1 0 0 0 1 0 0 0 nan, expected 9 finite"),
            ("1,0,3,1,1 0 0 0 1 0 0 0 -1,0 0 700,-1".into(), "expected a rotation matrix"),
            ("1,0,3,1,1 0 0 0 1 0 0 0 1,0 0 1e308,-1".into(), "t is 0 0 1e308, expected millimetres"),
            (
                "1,0,3,1,1 0 0 0 1 0 0 0 1,0 0 700,-0.5".into(),
                "time is -0.5, expected seconds, -1 when unknown",
            ),
            ("1,0,3,1,1 0 0 0 1 0 0 0 1,0 0 700,".into(), "time is empty"),
            ("1,0,-3,1,1 0 0 0 1 0 0 0 1,0 0 700,-1".into(), "obj_id is -3, expected a non-negative integer"),
            ("1,0,4294967296,1,1 0 0 0 1 0 0 0 1,0 0 700,-1".into(), "obj_id is 4294967296"),
            (format!("{LINE}\r\n1.5,0,3,1,1 0 0 0 1 0 0 0 1,0 0 700,-1\r\n"), "line 2: scene_id is 1.5"),
            ("1,0,3,1,2 0 0 0 1 0 0 0 1,0 0 700,-1".into(), "R is 2 0 0 0 1 0 0 0 1, expected a rotation"),
            (
                format!("{LINE}\n{LINE}"),
                "line 2: line is a repetition, expected another pose or score than in line 1",
            ),
            (
                format!("{LINE}\n1,0,4,0.5,1 0 0 0 1 0 0 0 1,0 0 700,0.5"),
                "line 2: time is 0.5, expected -1 as in line 1",
            ),
            ("scene_id,im_id,obj_id,R,score,t,time".into(), "header"),
        ] {
            let message = read(&text).unwrap_err().to_string();
            assert!(message.contains("m_d-test.csv") && message.contains(part), "{message}");
        }
    }

    #[test]
    fn the_name_has_one_underscore() {
        assert_eq!(result_file_name("fpfh_ransac-icp", "dev", "test"), "fpfh-ransac-icp_dev-test.csv");
    }
}
