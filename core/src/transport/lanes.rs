//! Eight f32 at a time: AVX2 with FMA and F16C where the processor has them, and a
//! portable form that gives the same numbers up to the rounding of fused products.

/// Eight lanes of f32.
///
/// Methods of the AVX2 form may be called only inside functions compiled for it;
/// [`super::evaluate::Kernel`] sees to that.
pub trait Lanes: Copy {
    /// All lanes equal.
    fn splat(value: f32) -> Self;
    /// From memory.
    fn load(values: &[f32; 8]) -> Self;
    /// To memory.
    fn store(self, out: &mut [f32; 8]);
    /// From IEEE half precision.
    fn from_f16(bits: &[u16; 8]) -> Self;
    /// Product.
    fn mul(self, other: Self) -> Self;
    /// `self · b + c`.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// Sum of the lanes, ((0+4)+(2+6)) + ((1+5)+(3+7)).
    fn sum(self) -> f32;
    /// `a · b + c` of single numbers, as [`Lanes::mul_add`] rounds it.
    fn fused(a: f32, b: f32, c: f32) -> f32;
    /// Asks for what lies `distance` values after `value` to be brought near; it need not exist.
    #[inline(always)]
    fn prefetch<T>(_value: &T, _distance: usize) {}
}

/// Plain arrays.
#[derive(Clone, Copy)]
pub struct Portable([f32; 8]);

impl Lanes for Portable {
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 8])
    }
    #[inline(always)]
    fn load(values: &[f32; 8]) -> Self {
        Self(*values)
    }
    #[inline(always)]
    fn store(self, out: &mut [f32; 8]) {
        *out = self.0;
    }
    #[inline(always)]
    fn from_f16(bits: &[u16; 8]) -> Self {
        Self(bits.map(widened))
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * other.0[i]))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * b.0[i] + c.0[i]))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        let v = self.0;
        ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
    }
    #[inline(always)]
    fn fused(a: f32, b: f32, c: f32) -> f32 {
        a * b + c
    }
}

/// A finite number in half precision, without a branch, so that compilers vectorise it.
#[inline(always)]
fn widened(half: u16) -> f32 {
    const SMALLEST_NORMAL: u32 = (127 - 14) << 23;
    let magnitude = u32::from(half & 0x7fff) << 13;
    let normal = f32::from_bits(magnitude + ((127 - 15) << 23));
    let subnormal = f32::from_bits(magnitude | SMALLEST_NORMAL) - f32::from_bits(SMALLEST_NORMAL);
    let value = if half & 0x7c00 == 0 {
        subnormal
    } else {
        normal
    };
    f32::from_bits(value.to_bits() | u32::from(half & 0x8000) << 16)
}

/// One AVX register.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub struct Avx2(std::arch::x86_64::__m256);

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Avx2, Lanes};
    use std::arch::x86_64::*;

    // SAFETY of every block below: AVX2, FMA and F16C exist wherever an `Avx2` is made,
    // because the kernel is chosen by run-time detection; pointers come from arrays of
    // the length that is read or written.
    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(value: f32) -> Self {
            unsafe { Self(_mm256_set1_ps(value)) }
        }
        #[inline(always)]
        fn load(values: &[f32; 8]) -> Self {
            unsafe { Self(_mm256_loadu_ps(values.as_ptr())) }
        }
        #[inline(always)]
        fn store(self, out: &mut [f32; 8]) {
            unsafe { _mm256_storeu_ps(out.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn from_f16(bits: &[u16; 8]) -> Self {
            unsafe { Self(_mm256_cvtph_ps(_mm_loadu_si128(bits.as_ptr().cast()))) }
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn mul_add(self, b: Self, c: Self) -> Self {
            unsafe { Self(_mm256_fmadd_ps(self.0, b.0, c.0)) }
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            unsafe {
                let four = _mm_add_ps(
                    _mm256_castps256_ps128(self.0),
                    _mm256_extractf128_ps::<1>(self.0),
                );
                let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
        #[inline(always)]
        fn fused(a: f32, b: f32, c: f32) -> f32 {
            unsafe { _mm_cvtss_f32(_mm_fmadd_ss(_mm_set_ss(a), _mm_set_ss(b), _mm_set_ss(c))) }
        }
        #[inline(always)]
        fn prefetch<T>(value: &T, distance: usize) {
            let address = std::ptr::from_ref(value).wrapping_add(distance);
            // Never read through: any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast()) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn both_forms_agree() {
        if !(is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("f16c"))
        {
            // Without AVX2 only the portable form exists.
            return;
        }
        let halves = [
            0x3c00u16, 0x0001, 0x7bff, 0x8000, 0x3555, 0x0400, 0x5640, 0xbc01,
        ];
        let (a, b) = (Portable::from_f16(&halves), Avx2::from_f16(&halves));
        let mut out = [[0.0f32; 8]; 2];
        a.store(&mut out[0]);
        b.store(&mut out[1]);
        assert_eq!(out[0], out[1]);
        assert_eq!(
            a.mul(Portable::splat(0.3)).sum(),
            b.mul(Avx2::splat(0.3)).sum()
        );
    }
}
