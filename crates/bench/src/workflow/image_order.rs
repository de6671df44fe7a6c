//! Whether the order of images contradicts the numbers in their names, as that of a shell's
//! pattern does: `light1`, `light10`, `light11`, `light2`.

use std::path::Path;

/// The names without folders, in the order given, where they differ in numbers alone and these do
/// not increase.
pub(super) fn disorder(files: &[&str]) -> Option<String> {
    let names: Vec<_> = files
        .iter()
        .map(|file| Path::new(file).file_name().map(|n| n.to_string_lossy()))
        .collect::<Option<_>>()?;
    let split: Vec<_> = names.iter().map(|name| text_and_numbers(name)).collect();
    let (first_text, _) = split.first()?;
    let comparable = split.iter().all(|(text, _)| text == first_text);
    let in_order = split.windows(2).all(|pair| pair[0].1 <= pair[1].1);
    (comparable && !in_order).then(|| {
        let shown = names.iter().take(SHOWN).map(|name| &**name);
        let more = if names.len() > SHOWN { ", …" } else { "" };
        shown.collect::<Vec<_>>().join(", ") + more
    })
}

/// Names that are shown.
const SHOWN: usize = 4;

/// The text of a name with a mark for each number, and the numbers without leading zeros, by
/// length and then by digits so that they compare by value.
fn text_and_numbers(name: &str) -> (String, Vec<(usize, &str)>) {
    let (mut text, mut numbers) = (String::new(), Vec::new());
    let mut rest = name;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(at);
        let end = from.find(|c: char| !c.is_ascii_digit());
        let (digits, after) = from.split_at(end.unwrap_or(from.len()));
        let digits = digits.trim_start_matches('0');
        text.push_str(before);
        text.push('0');
        numbers.push((digits.len(), digits));
        rest = after;
    }
    text.push_str(rest);
    (text, numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_out_of_order_are_found() {
        for (names, expected) in [
            (
                &["a/light1.exr", "a/light10.exr", "a/light2.exr"][..],
                Some("light1.exr, light10.exr, light2.exr"),
            ),
            (
                &["5.exr", "4.exr", "3.exr", "2.exr", "1.exr"],
                Some("5.exr, 4.exr, 3.exr, 2.exr, …"),
            ),
            (&["light1.exr", "light2.exr", "light10.exr"], None),
            (&["L_009.exr", "L_10.exr"], None),
            (&["x2/a.exr", "x1/a.exr"], None),
            // By name, not by number.
            (&["left2.exr", "right1.exr"], None),
            (&["merged.exr"], None),
            (&[], None),
        ] {
            assert_eq!(disorder(names).as_deref(), expected, "{names:?}");
        }
    }
}
