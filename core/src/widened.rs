//! Loops that do more numbers at a time where the processor can.
//!
//! A program for every processor of an architecture uses the instructions that all of them have.
//! What [`widened!`] defines is compiled a second time, for AVX2, which does eight numbers of
//! single precision at a time instead of four. Nothing is fused or reordered: the results are the
//! same to the last bit.

/// Defines functions that are compiled for AVX2 besides, and taken where the processor has it.
/// What they call gains only where it is inlined.
macro_rules! widened {
    ($(
        $(#[$attribute:meta])*
        $visible:vis fn $name:ident $(<const $size:ident: usize>)? ($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block
    )*) => {$(
        $(#[$attribute])*
        $visible fn $name $(<const $size: usize>)? ($($argument: $type),*) $(-> $result)? {
            #[inline(always)]
            fn plain $(<const $size: usize>)? ($($argument: $type),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn with_avx2 $(<const $size: usize>)? ($($argument: $type),*) $(-> $result)? {
                    plain$(::<$size>)?($($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has AVX2.
                    return unsafe { with_avx2$(::<$size>)?($($argument),*) };
                }
            }
            plain$(::<$size>)?($($argument),*)
        }
    )*};
}
pub(crate) use widened;
