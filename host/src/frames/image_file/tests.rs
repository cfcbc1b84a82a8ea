use super::*;
use tiff::encoder::{TiffEncoder, colortype};

fn saved(name: &str, save: impl FnOnce(&Path)) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    save(&path);
    (folder, path)
}

#[test]
fn grey_of_8_and_16_bits_comes_back_as_it_was() {
    let (_keep, path) = saved("a.png", |p| {
        image::GrayImage::from_raw(3, 2, vec![1, 2, 3, 4, 5, 255]).unwrap().save(p).unwrap();
    });
    assert_eq!(read(&path).unwrap(), (Picture::grey8(3, 2, vec![1, 2, 3, 4, 5, 255]).unwrap(), None));

    let (_keep, path) = saved("a.tif", |p| {
        let grey = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 1, vec![7u16, 65_535]).unwrap();
        grey.save(p).unwrap();
    });
    assert_eq!(read(&path).unwrap(), (Picture::grey16(2, 1, vec![7, 65_535]).unwrap(), None));
}

#[test]
fn colour_becomes_luma_and_says_so() {
    let (_keep, path) = saved("c.png", |p| {
        let raw = vec![255, 255, 255, 255, 0, 0, 0, 255, 0, 0, 0, 255];
        image::RgbImage::from_raw(4, 1, raw).unwrap().save(p).unwrap();
    });
    let (picture, note) = read(&path).unwrap();
    assert_eq!(picture, Picture::grey8(4, 1, vec![255, 76, 150, 29]).unwrap());
    assert_eq!(note, Some(Note::ColourToGrey));

    let (_keep, path) = saved("w.png", |p| {
        let raw = vec![65_535u16, 65_535, 65_535, 9];
        image::ImageBuffer::<image::Rgba<u16>, _>::from_raw(1, 1, raw).unwrap().save(p).unwrap();
    });
    let expected = (Picture::grey16(1, 1, vec![65_535]).unwrap(), Some(Note::ColourToGreyAlphaDropped));
    assert_eq!(read(&path).unwrap(), expected);
}

#[test]
fn a_tiff_gives_all_its_pages() {
    let (_keep, path) = saved("stack.tif", |p| {
        let mut tiff = TiffEncoder::new(File::create(p).unwrap()).unwrap();
        for page in 0..3u16 {
            tiff.write_image::<colortype::Gray16>(2, 1, &[page, 100 + page]).unwrap();
        }
    });
    let (pages, note) = read_pages(&path).unwrap();
    let expected: Vec<_> = (0..3).map(|n| Picture::grey16(2, 1, vec![n, 100 + n]).unwrap()).collect();
    assert_eq!((pages, note), (expected, None));
    assert_eq!(read(&path).unwrap().0, Picture::grey16(2, 1, vec![0, 100]).unwrap());
}

#[test]
fn what_is_no_grey_picture_is_refused_by_name() {
    let (_keep, path) = saved("float.tif", |p| {
        let mut tiff = TiffEncoder::new(File::create(p).unwrap()).unwrap();
        tiff.write_image::<colortype::Gray32Float>(1, 1, &[0.5]).unwrap();
    });
    let message = read(&path).unwrap_err().to_string();
    assert!(message.contains("float.tif") && message.contains("floating-point"), "{message}");

    let (_keep, path) = saved("signed.tif", |p| {
        let mut tiff = TiffEncoder::new(File::create(p).unwrap()).unwrap();
        tiff.write_image::<colortype::GrayI16>(1, 1, &[-5]).unwrap();
    });
    assert!(matches!(read(&path), Err(ImageFileError::Pixels { kind, .. }) if kind.contains("signed")));

    let (_keep, path) = saved("text.png", |p| std::fs::write(p, "no picture at all").unwrap());
    assert!(read(&path).is_err());

    let (_keep, path) = saved("cut.png", |p| {
        image::GrayImage::new(64, 64).save(p).unwrap();
        let whole = std::fs::read(p).unwrap();
        std::fs::write(p, &whole[..whole.len() / 2]).unwrap();
    });
    assert!(matches!(read(&path), Err(ImageFileError::Decode { .. })));
    assert!(matches!(read(Path::new("nowhere/z000.png")), Err(ImageFileError::Read { .. })));
}
