//! The picture of a run: the drive on the map, and speed and steering over time, as one SVG file.
//!
//! The map has the same scale in both directions. It shows the part of the track that was driven; a long drive is
//! folded into several strips, one above the other. Everything is clipped to the strip it is drawn in, because
//! the drawing library would pull points outside the axes to the border. The library knows whole pixels only,
//! so the picture is drawn `FINE` times larger and declared that much smaller.

pub mod chart;
mod clip;
mod curves;
mod legend;
mod map;
pub mod panels;

use emulator::JudgedBy;
use plotters::chart::MeshStyle;
use plotters::coord::types::RangedCoordf64;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use vehicle::Goal;
use vehicle::course::CourseOutline;

/// Width of the picture [pixels].
const WIDTH: u32 = 1200;
/// Free space at the left and right edge [pixels].
const EDGE: u32 = 8;
/// Fine steps per pixel.
const FINE: u32 = 4;

/// The true path.
const TRUE_PATH: RGBColor = RGBColor(0, 92, 158);
/// The estimated path.
const ESTIMATED_PATH: RGBColor = RGBColor(240, 110, 0);
/// The body of the robot.
const BODY: RGBColor = RGBColor(86, 160, 211);
/// Ellipses that the centre of the robot keeps out of.
const ELLIPSE: RGBColor = RGBColor(196, 78, 120);
/// Real obstacles and walls.
const OBSTACLE: RGBColor = RGBColor(70, 70, 75);
/// The goal and its tolerance.
const GOAL: RGBColor = RGBColor(0, 140, 95);
/// Bounds without a wall.
const BOUND: RGBColor = RGBColor(130, 130, 135);
/// The ground inside the bounds of the track.
const TRACK: RGBColor = RGBColor(249, 249, 244);
/// Text and axes.
const INK: RGBColor = RGBColor(50, 50, 55);
/// Lines of the grid.
const GRID: RGBColor = RGBColor(228, 228, 230);

type Result<T> = std::result::Result<T, PictureError>;
type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Axes<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Mesh<'a, 'b, 'c> = MeshStyle<'a, 'b, RangedCoordf64, RangedCoordf64, SVGBackend<'c>>;

/// The outline of an obstacle.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ObstacleOutline {
    /// Its corners in order; a circle is given as a polygon [m].
    pub points: Vec<[f64; 2]>,
    /// Where it was how far from `points`, in the order of time; empty for one that stands.
    pub places: Vec<TimedOffset>,
}

/// Where a moving obstacle was at a time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TimedOffset {
    /// Time since the start of the run [s].
    pub time_s: f64,
    /// Its offset from the corners of its shape along the track [m].
    pub x_m: f64,
    /// Its offset across the track [m].
    pub y_m: f64,
}

/// What stays the same during a run.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureScene {
    /// First line of the picture.
    pub title: String,
    /// Second line of the picture.
    pub subtitle: String,
    /// Bounds along the track, (7.45) [m].
    pub track_x_m: [f64; 2],
    /// Bounds across the track, (7.46) [m].
    pub track_y_m: [f64; 2],
    /// The course, whose way is drawn instead of the bounds above.
    pub course: Option<CourseOutline>,
    /// Whether walls stand at the lateral bounds.
    pub walls: bool,
    /// Real obstacles.
    pub obstacles: Vec<ObstacleOutline>,
    /// Where the drive starts [m].
    pub start_m: [f64; 2],
    /// The goals, in the plane.
    pub goals: Vec<Goal>,
    /// Length of the robot's body [m].
    pub body_length_m: f64,
    /// Width of the robot's body [m].
    pub body_width_m: f64,
    /// How far its middle is ahead of the reference point [m].
    pub body_x_m: f64,
}

/// State of the robot at one scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// Time since the start [s].
    pub time_s: f64,
    /// Position along the track [m].
    pub x_m: f64,
    /// Lateral position [m].
    pub y_m: f64,
    /// Yaw [rad].
    pub yaw_rad: f64,
    /// Speed over ground [m/s].
    pub speed_mps: f64,
    /// Steering angle at the wheels [rad].
    pub steering_rad: f64,
}

/// An ellipse with axes along and across the track, (7.34).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ellipse {
    /// Centre along the track [m].
    pub x_m: f64,
    /// Centre across the track [m].
    pub y_m: f64,
    /// Semi-axis along the track [m].
    pub a_m: f64,
    /// Semi-axis across the track [m].
    pub b_m: f64,
}

/// What happened in a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PictureDrive {
    /// States, one per scan in order: the true ones if they are known.
    pub moments: Vec<Moment>,
    /// Estimated positions, one per scan in order [m].
    pub estimates: Vec<[f64; 2]>,
    /// All ellipses that were described, in their last version.
    pub ellipses: Vec<Ellipse>,
    /// With `Estimate` the moments are estimated, and there is no true path.
    pub judged_by: JudgedBy,
}

/// The picture could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("the picture could not be drawn: {0}")]
pub struct PictureError(String);

impl From<DrawingAreaErrorKind<std::io::Error>> for PictureError {
    fn from(error: DrawingAreaErrorKind<std::io::Error>) -> Self {
        Self(error.to_string())
    }
}

/// Draws a run as the text of an SVG file.
///
/// # Errors
/// [`PictureError`] when the drawing library refuses.
pub fn draw(scene: &PictureScene, drive: &PictureDrive) -> Result<String> {
    let layout = map::Layout::of(scene, drive);
    svg(legend::HEIGHT + layout.height() + curves::HEIGHT, |root| {
        let (head, rest) = root.split_vertically(fine(legend::HEIGHT));
        let (maps, below) = rest.split_vertically(fine(layout.height()));
        legend::draw(&head, scene, &layout, drive.judged_by)?;
        layout.draw(&maps, scene, drive)?;
        curves::draw(&below, &drive.moments)
    })
}

/// The text of an SVG file of this height [pixels] with what `paint` draws.
fn svg(height: u32, paint: impl FnOnce(&Area<'_>) -> Result<()>) -> Result<String> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH * FINE, height * FINE)).into_drawing_area();
        root.fill(&WHITE)?;
        paint(&root)?;
        root.present()?;
    }
    let drawn = format!("width=\"{}\" height=\"{}\"", WIDTH * FINE, height * FINE);
    Ok(svg.replacen(&drawn, &format!("width=\"{WIDTH}\" height=\"{height}\""), 1))
}

/// Grid, axes and labels in the style of all pictures.
fn mesh<'a, 'b, 'c>(axes: &'b mut Axes<'a, 'c>) -> Mesh<'a, 'b, 'c> {
    let mut mesh = axes.configure_mesh();
    mesh.max_light_lines(0)
        .bold_line_style(GRID.stroke_width(fine(1) as u32))
        .axis_style(INK.stroke_width(fine(1) as u32))
        .label_style(font(12).into_font().color(&INK))
        .axis_desc_style(font(13).into_font().color(&INK))
        .set_all_tick_mark_size(fine(4));
    mesh
}

/// Writes a line of text to the right of (x, y) [pixels].
fn text(area: &Area<'_>, text: &str, size: u32, x: u32, y: u32) -> Result<()> {
    let style = font(size).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
    Ok(area.draw_text(text, &style, (fine(x), fine(y)))?)
}

/// Pixels as fine steps.
const fn fine(pixels: u32) -> i32 {
    (pixels * FINE) as i32
}

/// The font of all text; the library draws 1.24 times smaller than asked.
fn font(pixels: u32) -> (&'static str, i32) {
    ("sans-serif", fine(pixels) * 5 / 4)
}

#[cfg(test)]
mod tests {
    use vehicle::Course;
    use vehicle::course::{CourseKeys, Waypoint};

    use super::*;

    fn scene() -> PictureScene {
        PictureScene {
            title: "corridor: reached".to_owned(),
            subtitle: "12.7 s, smallest clearance 0.35 m".to_owned(),
            track_x_m: [0.0, 22.0],
            track_y_m: [-1.5, 1.5],
            course: None,
            walls: true,
            obstacles: vec![ObstacleOutline {
                points: vec![[4.95, -0.2], [5.05, -0.2], [5.05, 0.2], [4.95, 0.2]],
                places: Vec::new(),
            }],
            start_m: [0.0, 0.0],
            goals: vec![Goal::default()],
            body_length_m: 0.56,
            body_width_m: 0.4,
            body_x_m: 0.0,
        }
    }

    /// A drive of `seconds` at 0.8 m/s that swings out by 0.77 m at x = 5.
    fn drive(seconds: f64) -> PictureDrive {
        let moment = |scan: usize| {
            let time_s = scan as f64 * 0.1;
            let x_m = 0.8 * time_s;
            let y_m = 0.77 * (-((x_m - 5.0) / 1.8).powi(2)).exp();
            let slope = -2.0 * (x_m - 5.0) / 1.8_f64.powi(2) * y_m;
            Moment {
                time_s,
                x_m,
                y_m,
                yaw_rad: slope.atan(),
                speed_mps: 0.8,
                steering_rad: 0.05 * (x_m - 3.0).sin(),
            }
        };
        let moments: Vec<Moment> = (0..(seconds * 10.0) as usize).map(moment).collect();
        PictureDrive {
            estimates: moments.iter().map(|moment| [moment.x_m + 0.01, moment.y_m - 0.02]).collect(),
            ellipses: vec![Ellipse { x_m: 5.0, y_m: 0.0, a_m: 1.2, b_m: 0.6 }],
            moments,
            judged_by: JudgedBy::Truth,
        }
    }

    /// All numbers of `points="x,y x,y"` attributes.
    fn coordinates(svg: &str) -> Vec<(f64, f64)> {
        let lists = svg.split("points=\"").skip(1).filter_map(|rest| rest.split('"').next());
        let pairs = lists.flat_map(str::split_whitespace).filter_map(|pair| pair.split_once(','));
        pairs.map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).collect()
    }

    #[test]
    fn the_picture_is_one_svg_of_the_declared_size_with_its_texts() {
        let svg = draw(&scene(), &drive(12.5)).unwrap();
        assert!(svg.starts_with("<svg width=\"1200\" height=\"") && svg.trim_end().ends_with("</svg>"));
        for text in
            ["corridor: reached", "smallest clearance", "true path", "x [m]", "speed [m/s]", "steering [rad]"]
        {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn without_a_truth_no_true_path_is_drawn() {
        let svg = draw(&scene(), &PictureDrive { judged_by: JudgedBy::Estimate, ..drive(12.5) }).unwrap();
        assert!(!svg.contains("true path") && svg.contains("estimated path"));
        let paths = |svg: &str| coordinates(svg).len();
        assert!(paths(&svg) < paths(&draw(&scene(), &drive(12.5)).unwrap()));
    }

    #[test]
    fn a_moving_obstacle_is_drawn_along_its_way_with_times() {
        let standing = draw(&scene(), &drive(12.5)).unwrap();
        let mut scene = scene();
        let place =
            |second: u32| TimedOffset { time_s: f64::from(second), x_m: 0.0, y_m: 0.2 * f64::from(second) };
        scene.obstacles[0].places = (0..4).map(place).collect();
        let moving = draw(&scene, &drive(12.5)).unwrap();
        let outlines = |svg: &str| svg.matches("<polygon").count();
        assert_eq!(outlines(&moving), outlines(&standing) + 3, "one at each place");
        for label in ["1 s", "3 s"] {
            // One at the obstacle and one at the robot.
            assert_eq!(moving.matches(&format!("\n{label}\n")).count(), 2, "{label}");
            assert!(!standing.contains(&format!("\n{label}\n")));
        }
    }

    #[test]
    fn a_course_is_drawn_whole_in_one_strip_in_place_of_the_bounds_of_the_track() {
        // From x = 30 m back to 0, further than a drive that is folded.
        let waypoints = [[0.0, 0.0], [30.0, 0.0], [30.0, 8.0], [0.0, 8.0]];
        let waypoints = waypoints.map(|[x_m, y_m]| Waypoint::new(x_m, y_m, None)).to_vec();
        let course = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap();
        let outline = course.outline([-2.0, course.length_m() + 2.0]);
        let straight = PictureScene { walls: false, ..scene() };
        let scene = PictureScene { course: Some(outline.clone()), ..straight.clone() };
        let svg = draw(&scene, &drive(12.5)).unwrap();
        assert!(svg.contains("course, and bounds of its way") && !svg.contains("bound of the track"));
        assert!(!draw(&straight, &drive(12.5)).unwrap().contains("course"));
        let layout = map::Layout::of(&scene, &drive(12.5));
        let (across, down) = layout.pixels_per_metre();
        assert!((across / down - 1.0).abs() < 0.01, "{across} and {down}");
        for [x_m, y_m] in outline.corners() {
            assert!(layout.shows(x_m, y_m), "{x_m}, {y_m}");
        }
    }

    #[test]
    fn a_long_drive_is_folded_into_strips() {
        let svg = draw(&scene(), &drive(125.0)).unwrap();
        assert_eq!(svg.matches("x [m]").count(), 1, "only the last strip names its axis");
        let height = |svg: &str| {
            svg.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse::<u32>().unwrap()
        };
        assert!(height(&svg) > height(&draw(&scene(), &drive(12.5)).unwrap()));
    }

    #[test]
    fn nothing_is_drawn_outside_the_picture() {
        let mut scene = scene();
        scene.track_y_m = [-1e7, 1e7];
        scene.obstacles.push(ObstacleOutline {
            points: vec![[-500.0, -1.0], [800.0, -1.0], [800.0, -0.9], [-500.0, -0.9]],
            ..ObstacleOutline::default()
        });
        let mut drive = drive(12.5);
        drive.ellipses.push(Ellipse { x_m: 90.0, y_m: 40.0, a_m: 100.0, b_m: 70.0 });
        let svg = draw(&scene, &drive).unwrap();
        let viewed = svg.split("viewBox=\"0 0 ").nth(1).unwrap().split('"').next().unwrap();
        let (width, height) = viewed.split_once(' ').unwrap();
        let (width, height): (f64, f64) = (width.parse().unwrap(), height.parse().unwrap());
        for (x, y) in coordinates(&svg) {
            assert!((0.0..=width).contains(&x) && (0.0..=height).contains(&y), "{x}, {y}");
        }
    }

    #[test]
    fn both_directions_have_the_same_scale() {
        let layout = map::Layout::of(&scene(), &drive(12.5));
        let (across, down) = layout.pixels_per_metre();
        // The height of a strip is a whole number of pixels.
        assert!((across / down - 1.0).abs() < 0.01, "{across} and {down}");
    }

    #[test]
    fn a_run_without_samples_or_with_nonsense_is_drawn_too() {
        draw(&scene(), &PictureDrive::default()).unwrap();
        let nonsense = Moment { x_m: f64::NAN, y_m: f64::INFINITY, time_s: f64::NAN, ..Moment::default() };
        let far = Moment { x_m: 1e300, y_m: -1e300, time_s: 1e300, speed_mps: 1e300, ..Moment::default() };
        let ellipse = Ellipse { x_m: f64::NAN, a_m: f64::INFINITY, ..Ellipse::default() };
        let drive = PictureDrive {
            moments: vec![nonsense, far],
            estimates: vec![[f64::NAN; 2]],
            ellipses: vec![ellipse],
            ..PictureDrive::default()
        };
        draw(&scene(), &drive).unwrap();
        let goals = vec![Goal { x_m: f64::NAN, y_m: f64::NAN, ..Goal::default() }];
        draw(&PictureScene { goals, body_length_m: f64::NAN, ..scene() }, &drive).unwrap();
    }

    #[test]
    fn an_hour_makes_a_file_of_less_than_a_megabyte() {
        let svg = draw(&scene(), &drive(3600.0)).unwrap();
        assert!(svg.len() < 1_000_000, "{}", svg.len());
    }
}
