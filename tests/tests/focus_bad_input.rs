//! What people get wrong with `parfocal focus`: one sentence that says what and where.

use parfocal_tests::parfocal;
use std::path::{Path, PathBuf};

/// Exit code and stderr of `parfocal focus ARGUMENTS`.
fn focus(arguments: &[&str]) -> (i32, String) {
    let output = parfocal().arg("focus").args(arguments).output().unwrap();
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A folder of pictures that are good, bad, and no pictures at all.
fn pictures() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let grey = |x: u32, y: u32| ((x * 37 + y * 91) % 251) as u8;
    image::GrayImage::from_fn(64, 48, |x, y| image::Luma([grey(x, y)])).save(at("grey.png")).unwrap();
    image::GrayImage::from_fn(1, 1, |_, _| image::Luma([9])).save(at("one.png")).unwrap();
    image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([grey(x, y), 7, 9])).save(at("colour.png")).unwrap();
    let float = image::Rgb32FImage::from_fn(8, 8, |x, _| image::Rgb([x as f32, 0.5, 0.25]));
    image::DynamicImage::ImageRgb32F(float).save(at("float.tiff")).unwrap();
    let whole = std::fs::read(at("grey.png")).unwrap();
    std::fs::write(at("cut.png"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(at("text.png"), "hello").unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    let path: PathBuf = folder.join(name);
    path.to_str().unwrap().into()
}

#[test]
fn pictures_that_cannot_be_measured_are_named_with_the_reason() {
    let folder = pictures();
    for (name, says) in [
        ("one.png", "tenengrad needs a region of at least 3x3 pixels, this one is 1x1"),
        ("float.tiff", "floating-point pixels; save it as 8- or 16-bit grey"),
        ("cut.png", "cannot be decoded"),
        ("text.png", "cannot be decoded"),
        ("nowhere.png", "cannot be read: No such file"),
    ] {
        let (code, said) = focus(&["measure", &path(folder.path(), name)]);
        assert!(code == 1 && said.contains(says) && said.contains(name), "{name}: {code} {said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert_eq!(said.matches("No such file").count(), usize::from(name == "nowhere.png"), "{said}");
    }
}

#[test]
fn colour_is_converted_and_said() {
    let folder = pictures();
    let (code, said) = focus(&["measure", &path(folder.path(), "colour.png")]);
    assert!(code == 0 && said.contains("colour, converted to grey"), "{code} {said}");
    // One pixel has a variance: none.
    let (code, said) = focus(&["measure", "--measure", "variance", &path(folder.path(), "one.png")]);
    assert_eq!((code, said.as_str()), (0, ""));
}

#[test]
fn regions_that_make_no_sense_are_refused() {
    let folder = pictures();
    let grey = path(folder.path(), "grey.png");
    for (roi, code, says) in [
        ("0,0,0,4", 1, "the region 0,0,0,4 is empty"),
        ("60,0,10,4", 1, "the region 60,0,10,4 leaves the picture of 64x48"),
        ("0,48,4,4", 1, "leaves the picture of 64x48"),
        ("18446744073709551615,0,1,1", 1, "leaves the picture of 64x48"),
        ("1,1,2,9", 1, "needs a region of at least 3x3 pixels, this one is 2x9"),
        ("-1,0,5,5", 2, "is not a region: write x,y,width,height"),
        ("1,2,3", 2, "is not a region: write x,y,width,height"),
        ("a,b,c,d", 2, "is not a region: write x,y,width,height"),
    ] {
        let (got, said) = focus(&["measure", &grey, &format!("--roi={roi}")]);
        assert!(got == code && said.contains(says), "{roi}: {got} {said}");
    }
    // An odd region with a stride of its own is as good as any.
    assert_eq!(focus(&["measure", &grey, "--roi", "61,1,3,47"]), (0, String::new()));
}

#[test]
fn stacks_and_benches_say_what_is_missing() {
    let folder = pictures();
    for (arguments, code, says) in [
        (["compare", &path(folder.path(), "nowhere")], 1, "nowhere: cannot be read"),
        (["compare", &path(folder.path(), "")], 1, "stack.toml: is missing"),
        (["bench", "--runs=0"], 2, "0 is not in 1.."),
        (["bench", &format!("--picture={}", path(folder.path(), "float.tiff"))], 1, "save it as 8- or 16-bit grey"),
        (["measure", "--measure=sharpness"], 2, "is no focus measure: choose one of variance,"),
    ] {
        let (got, said) = focus(&arguments);
        assert!(got == code && said.contains(says), "{arguments:?}: {got} {said}");
    }
}
