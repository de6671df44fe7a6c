//! `rig calibrate status`: every record in force, at a glance.

use jiff::Timestamp;
use serde::Serialize;

use crate::calibration::camera::{CameraValues, LensModel};
use crate::calibration::directions::DirectionsValues;
use crate::calibration::fitness::Concern;
use crate::calibration::pose::PoseValues;
use crate::calibration::record::{
    FlatValues, Kind, LampValues, LightsValues, Measured, ResponseValues, ScaleValues,
    SensorValues, Values,
};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded};
use crate::cli::output::write_json;
use crate::cli::rig_choice::RigArg;
use crate::cli::{CliError, Context};
use crate::config::RigConfig;
use crate::out;

#[derive(clap::Args, Debug)]
pub(super) struct StatusArgs {
    #[command(flatten)]
    rig: RigArg,
    /// The same as JSON
    #[arg(long)]
    json: bool,
}

/// How a kind of record stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    /// It fits.
    Good,
    /// It can be used, but something speaks against it.
    Doubtful,
    /// A capture refuses it, or it cannot be read.
    Refused,
    /// There is none.
    Missing,
}

#[derive(Serialize)]
struct Line {
    kind: &'static str,
    state: State,
    id: Option<String>,
    date: Option<String>,
    age_days: Option<f64>,
    gain: Option<f64>,
    device_serial: Option<String>,
    method: Option<String>,
    /// The main values with their uncertainties, in words.
    summary: String,
    /// What speaks against it.
    concerns: Vec<String>,
    /// What to run where something does.
    run: Option<String>,
}

#[derive(Serialize)]
struct Report {
    rig: String,
    library: String,
    records: Vec<Line>,
}

pub(super) fn run(args: &StatusArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.rig.resolve(context)?;
    let library = Library::of_rig(&rig);
    let pins = &rig.config.calibration;
    let pinned = |pin: &Option<String>| pin.clone();
    let records = vec![
        line(&rig.config, &library, pinned(&pins.sensor), of_sensor),
        line(&rig.config, &library, pinned(&pins.flat), of_flat),
        line(&rig.config, &library, pinned(&pins.scale), of_scale),
        line(&rig.config, &library, pinned(&pins.lights), of_lights),
        line(
            &rig.config,
            &library,
            pinned(&pins.directions),
            of_directions,
        ),
        line(&rig.config, &library, None, of_lamp),
        line(&rig.config, &library, pinned(&pins.focus), of_focus),
        line(&rig.config, &library, pinned(&pins.pose), of_pose),
        line(&rig.config, &library, None, of_response),
        line(&rig.config, &library, pinned(&pins.camera), of_camera),
    ];
    if args.json {
        return write_json(&Report {
            rig: rig.config.name.clone(),
            library: library.place(),
            records,
        });
    }
    out!("{}: records in {}", rig.config.name, library.place())?;
    for line in &records {
        let mark = match line.state {
            State::Good => "ok",
            State::Doubtful => "doubtful",
            State::Refused => "refused",
            State::Missing => "none",
        };
        let age = line.age_days.map_or(String::new(), |days| match days {
            days if days < 1.0 => "today".to_owned(),
            days => format!("{days:.0} d"),
        });
        out!("{:<9} {mark:<9} {age:>6}  {}", line.kind, line.summary)?;
        for concern in &line.concerns {
            out!("{:<26}  {concern}", "")?;
        }
        if let Some(run) = &line.run {
            out!("{:<26}  run `{run}`", "")?;
        }
    }
    Ok(())
}

/// How one kind stands.
fn line<V: Values>(
    rig: &RigConfig,
    library: &Library,
    pinned: Option<String>,
    summary: impl Fn(&V) -> String,
) -> Line {
    let kind = V::KIND;
    let run = || Some(format!("rig calibrate {}", kind.command()));
    let mut line = Line {
        kind: kind.folder(),
        state: State::Missing,
        id: None,
        date: None,
        age_days: None,
        gain: None,
        device_serial: None,
        method: None,
        summary: without(kind).to_owned(),
        concerns: Vec::new(),
        run: None,
    };
    let loaded: Loaded<V> = match library.load_for(pinned.as_deref(), rig.camera.gain) {
        Ok(Some(loaded)) => loaded,
        Ok(None) => {
            // A linear camera has no response; lights and pose can stand in the rig file.
            let can_stand_in_the_rig_file = matches!(
                kind,
                Kind::Lights | Kind::Directions | Kind::Pose | Kind::Focus | Kind::Camera
            );
            line.run = (kind != Kind::Response && !can_stand_in_the_rig_file)
                .then(run)
                .flatten();
            return line;
        }
        Err(error) => {
            line.state = State::Refused;
            line.summary = "cannot be read".to_owned();
            line.concerns.push(error.to_string());
            line.run = run();
            return line;
        }
    };
    let now = Timestamp::now();
    let serial = rig.camera.serial.as_deref().unwrap_or_default();
    let concerns = loaded.concerns_on(rig.is_simulated(), serial, &rig.camera, now);
    let refused = concerns.iter().any(|c| matches!(c, Concern::Other(_)));
    line.state = match (concerns.is_empty(), refused) {
        (true, _) => State::Good,
        (false, true) => State::Refused,
        (false, false) => State::Doubtful,
    };
    line.age_days = (!rig.is_simulated()).then(|| loaded.age_days(now));
    let record = loaded.record;
    line.summary = format!("{} ({})", summary(&record.values), record.id);
    line.run = (!concerns.is_empty()).then(run).flatten();
    line.concerns = concerns.iter().map(Concern::to_string).collect();
    line.gain = record.settings.gain;
    line.id = Some(record.id);
    line.date = Some(record.date);
    line.device_serial = Some(record.device_serial);
    line.method = Some(record.method);
    line
}

fn without(kind: Kind) -> &'static str {
    match kind {
        Kind::Sensor => "a capture needs it",
        Kind::Flat => "every pixel counts as equally sensitive",
        Kind::Scale => "radiances are relative",
        Kind::Lights => "the rig file's irradiance is believed",
        Kind::Directions => "the rig file's light directions are believed",
        Kind::Lamp => "nobody knows how long the lamp warms up",
        Kind::Pose => "the sample lies as the rig file says",
        Kind::Focus => "the rig file's point spread, focus and aperture are believed",
        Kind::Camera => "the lens is as the rig file says",
        Kind::Response => "counts are taken as proportional to light",
    }
}

/// Value and uncertainty, with as many digits as the uncertainty has two of.
fn pair(m: Measured) -> String {
    let digits = match m.std > 0.0 {
        true => (1.0 - m.std.log10().floor()).clamp(0.0, 9.0) as usize,
        false => 3,
    };
    format!("{:.digits$} ± {:.digits$}", m.value, m.std)
}

fn of_sensor(v: &SensorValues) -> String {
    format!(
        "gain {} DN/e⁻, read noise {} e⁻, full well {} e⁻, linear within {:.2}%, {} hot pixels",
        pair(v.gain_dn_per_e),
        pair(v.read_noise_e),
        pair(v.full_well_e),
        100.0 * v.linearity_error,
        v.hot_pixels.len()
    )
}

fn of_flat(v: &FlatValues) -> String {
    format!("response of each pixel known to {:.3}%", 100.0 * v.std)
}

fn of_scale(v: &ScaleValues) -> String {
    let relative = 100.0 * v.responsivity_e_s.std / v.responsivity_e_s.value;
    format!(
        "{:.4e} e⁻/s per W/(m² sr), known to {relative:.2}%",
        v.responsivity_e_s.value
    )
}

fn of_lights(v: &LightsValues) -> String {
    let [red, green, blue] = v.irradiance_w_m2.map(pair);
    format!("{red}, {green}, {blue} W/m²")
}

fn of_directions(v: &DirectionsValues) -> String {
    let distance = match v.distance_mm {
        Some(distance) => format!(", {} mm away", pair(distance)),
        None => String::new(),
    };
    format!(
        "{} lights, each within {:.3}°, all together within {:.3}°{distance}",
        v.lights.len(),
        v.light_std_deg,
        v.common_std_deg
    )
}

fn of_lamp(v: &LampValues) -> String {
    format!(
        "warm after {:.0} s, drift {} % per hour, steady from {}",
        v.warm_up_time_s,
        pair(Measured {
            value: 100.0 * v.drift_per_hour.value,
            std: 100.0 * v.drift_per_hour.std,
        }),
        v.steady_from_s
            .map_or("no measured exposure on".to_owned(), |s| format!("{s} s"))
    )
}

fn of_focus(v: &FocusValues) -> String {
    let lens = v.lens.map_or(String::new(), |lens| {
        let (focus, aperture) = (pair(lens.focus_mm), pair(lens.object_na));
        format!(", sharp at {focus} mm, aperture {aperture}")
    });
    format!("point spread {} px{lens}", pair(v.point_spread_px))
}

fn of_camera(v: &CameraValues) -> String {
    let unit = match v.model {
        LensModel::Perspective => "focal length",
        LensModel::Orthographic => "pixels per mm",
    };
    let number = |value: f64, names: [&str; 2]| match names.iter().find_map(|n| v.std(n)) {
        Some(std) => pair(Measured { value, std }),
        None => format!("{value:.3}"),
    };
    format!(
        "{unit} {}, {}, {} views, corners within {:.3} px{}",
        number(v.scale[0], ["fx", "mx"]),
        number(v.scale[1], ["fy", "my"]),
        v.views,
        v.residual_px,
        if v.pose.is_some() {
            ", with its pose"
        } else {
            ""
        }
    )
}

fn of_pose(v: &PoseValues) -> String {
    let std = v.deviations();
    let three = |values: [f64; 3], from: usize| {
        let pairs = (0..3).map(|i| {
            let std = std[from + i];
            pair(Measured {
                value: values[i],
                std,
            })
        });
        pairs.collect::<Vec<_>>().join(", ")
    };
    format!(
        "turned by {} deg, moved by {} mm, edges within {:.2} px",
        three(v.rotation_deg, 0),
        three(v.translation_mm, 3),
        v.residual_px
    )
}

fn of_response(v: &ResponseValues) -> String {
    format!("curves of {} channels", v.channels.len())
}
