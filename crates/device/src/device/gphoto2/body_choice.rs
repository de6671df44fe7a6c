//! The key `camera.body`: which body, and the settings that it is to have.

/// What the key may be, as errors state it.
pub(super) const ALLOWED: &str = "`name = value` with `;` between them: port (as `gphoto2 --auto-detect` lists it, or any), times (nominal or stops), base_iso, and settings that `gphoto2 --list-config` lists";

/// What a file's exposure time means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Times {
    /// What it says.
    #[default]
    Nominal,
    /// The power of two, in thirds or halves of a stop, that it is rounded from.
    Stops,
}

/// A body and its settings.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct BodyChoice {
    /// Port as gphoto2 names it; `None` (`any`): the only body, or that of the rig file's
    /// serial number.
    pub(super) port: Option<String>,
    /// What exposure times mean.
    pub(super) times: Times,
    /// Sensitivity of gain 1; `None`: the lowest that the body lists.
    pub(super) base_iso: Option<f64>,
    /// Names and values of further settings.
    pub(super) settings: Vec<(String, String)>,
}

impl BodyChoice {
    /// From the key's text; `None`: it is not of that form.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let mut choice = Self::default();
        let mut has_port = false;
        let parts = text.split(';').map(str::trim);
        for part in parts.filter(|part| !part.is_empty()) {
            let (name, value) = part.split_once('=')?;
            let (name, value) = (name.trim(), value.trim().to_owned());
            if name.is_empty() || value.is_empty() {
                return None;
            }
            match name {
                "port" => {
                    has_port = true;
                    choice.port = (value != "any").then_some(value);
                }
                "times" => {
                    choice.times = match value.as_str() {
                        "nominal" => Times::Nominal,
                        "stops" => Times::Stops,
                        _ => return None,
                    }
                }
                "base_iso" => {
                    let iso: f64 = value.parse().ok()?;
                    if !(1.0..=1e6).contains(&iso) {
                        return None;
                    }
                    choice.base_iso = Some(iso);
                }
                // These are the driver's.
                "shutterspeed" | "iso" => return None,
                _ => choice.settings.push((name.to_owned(), value)),
            }
        }
        has_port.then_some(choice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_is_named_by_its_port() {
        let parsed =
            BodyChoice::parse("port = usb:001,004; f-number = f/8;times=stops; base_iso=100");
        let choice = parsed.unwrap();
        assert_eq!(choice.port.as_deref(), Some("usb:001,004"));
        assert_eq!(choice.times, Times::Stops);
        assert_eq!(choice.base_iso, Some(100.0));
        assert_eq!(choice.settings, [("f-number".to_owned(), "f/8".to_owned())]);
        assert_eq!(BodyChoice::parse("port = any").unwrap().port, None);
        for refused in [
            "",
            "usb:001,004",
            "f-number = f/8",
            "port =",
            "= x",
            "port = any; times = exact",
            "port = any; base_iso = 0",
            "port = any; base_iso = nan",
            "port = any; iso = 100",
        ] {
            assert_eq!(BodyChoice::parse(refused), None, "{refused}");
        }
    }
}
