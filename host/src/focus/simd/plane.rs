//! Rows of pixels of one type: what the kernels work on.

/// A pixel's type.
pub trait Pixel: Copy + Ord + Into<i32> + Into<u32> + Into<u64> + 'static {
    /// Values that this type can take.
    const LEVELS: usize;

    /// The plane as bytes, if that is what its pixels are: the way to kernels written for 8 bits.
    fn bytes<'p, 'a>(plane: &'p Plane<'a, Self>) -> Option<&'p Plane<'a, u8>>
    where
        Self: Sized;

    /// The plane as 16-bit words, if that is what its pixels are.
    fn words<'p, 'a>(plane: &'p Plane<'a, Self>) -> Option<&'p Plane<'a, u16>>
    where
        Self: Sized;

    /// The square of a combination of pixels, exact. Only |weights| that add up to 40 or less are ever used.
    fn square(combination: i32) -> u64;
}

impl Pixel for u8 {
    const LEVELS: usize = 256;

    fn bytes<'p, 'a>(plane: &'p Plane<'a, u8>) -> Option<&'p Plane<'a, u8>> {
        Some(plane)
    }

    fn words<'p, 'a>(_: &'p Plane<'a, u8>) -> Option<&'p Plane<'a, u16>> {
        None
    }

    #[inline(always)]
    fn square(combination: i32) -> u64 {
        // 40 · 255 squared fits 32 bits, whose products are cheaper.
        u64::from((combination * combination).cast_unsigned())
    }
}

impl Pixel for u16 {
    const LEVELS: usize = 65_536;

    fn bytes<'p, 'a>(_: &'p Plane<'a, u16>) -> Option<&'p Plane<'a, u8>> {
        None
    }

    fn words<'p, 'a>(plane: &'p Plane<'a, u16>) -> Option<&'p Plane<'a, u16>> {
        Some(plane)
    }

    #[inline(always)]
    fn square(combination: i32) -> u64 {
        (i64::from(combination) * i64::from(combination)).cast_unsigned()
    }
}

/// `height` rows of `width` pixels, their starts `stride` pixels apart.
#[derive(Clone, Copy)]
pub struct Plane<'a, P> {
    pixels: &'a [P],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a, P: Pixel> Plane<'a, P> {
    /// `pixels` must hold `(height - 1) * stride + width` of them, as a `View` has made sure.
    pub fn new(pixels: &'a [P], width: usize, height: usize, stride: usize) -> Self {
        Self { pixels, width, height, stride }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Pixels in all.
    pub fn area(&self) -> usize {
        self.width * self.height
    }

    #[inline(always)]
    pub fn row(&self, y: usize) -> &'a [P] {
        &self.pixels[y * self.stride..][..self.width]
    }

    #[inline(always)]
    pub fn rows(&self) -> impl Iterator<Item = &'a [P]> + use<'a, '_, P> {
        (0..self.height).map(|y| self.row(y))
    }

    /// From one row's start to the next one's, in pixels.
    #[inline(always)]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// `ROWS` neighbouring rows, the first of them `y`.
    #[inline(always)]
    pub fn band<const ROWS: usize>(&self, y: usize) -> [&'a [P]; ROWS] {
        std::array::from_fn(|k| self.row(y + k))
    }
}
