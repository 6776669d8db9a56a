//! @description@, behind a guard against faulty signals. No heap, no standard library.
#![no_std]

use core::sync::atomic::{AtomicBool, Ordering};

/// Numbers of the filter.
pub type Real = @rust_real@;
/// Channels of x and g.
pub const N_X: usize = @n_x@;
/// Channels of f_theta and f_hat.
pub const N_F: usize = @n_f@;
/// Entries of the inertia that is given at every step, row by row; 0: none is.
pub const N_M: usize = @n_m@;
/// Seconds between samples.
pub const DT: f64 = @rust_dt@;

/// Flags of the health that a step returns; 0: nothing was wrong.
pub mod health {
    pub const MISSED: u32 = 1;
    pub const NOT_FINITE: u32 = 2;
    pub const TIME: u32 = 4;
    pub const LIMIT: u32 = 8;
    pub const REFUSED: u32 = 16;
    pub const STATE: u32 = 32;
    pub const REPAIRED: u32 = 64;
    pub const DAMAGED: u32 = 128;
}

extern "C" {
    fn @name@_rust_init(number: u32) -> i32;
    fn @name@_rust_step(
        number: u32, time: u64, x: *const Real, g: *const Real, f_theta: *const Real, inertia: *const Real, f_hat: *mut Real,
    ) -> u32;
    fn @name@_rust_check(number: u32);
}

const INSTANCES: usize = parse(env!("@NAME@_INSTANCES"));
static TAKEN: [AtomicBool; INSTANCES] = [const { AtomicBool::new(false) }; INSTANCES];

const fn parse(text: &str) -> usize {
    let (digits, mut value, mut i) = (text.as_bytes(), 0, 0);
    while i < digits.len() {
        value = 10 * value + (digits[i] - b'0') as usize;
        i += 1;
    }
    value
}

/// One filter. There are as many as `@NAME@_INSTANCES` says when building; dropping one gives it back.
pub struct Filter(u32);

impl Filter {
    /// The next free one, at its start; the error is the code of pf_filter.h, or -1 where all are taken.
    pub fn new() -> Result<Self, i32> {
        for (number, taken) in TAKEN.iter().enumerate() {
            if !taken.swap(true, Ordering::AcqRel) {
                let filter = Filter(number as u32);
                // SAFETY: the number is in range, and the flag gives this instance to one owner.
                let code = unsafe { @name@_rust_init(filter.0) };
                return if code == 0 { Ok(filter) } else { Err(code) };
            }
        }
        Err(-1)
    }

    /// One sample taken at `time` in microseconds: the estimate, finite whatever came in, and the health.
    pub fn step(&mut self, time: u64, x: &[Real; N_X], g: &[Real; N_X], f_theta: &[Real; N_F], inertia: Option<&[Real; N_M]>) -> ([Real; N_F], u32) {
        let mut f_hat = [0.0; N_F];
        let inertia = inertia.map_or(core::ptr::null(), |entries| entries.as_ptr());
        // SAFETY: lengths are those of the C code, &mut self is the only access to the instance.
        let health = unsafe {
            @name@_rust_step(self.0, time, x.as_ptr(), g.as_ptr(), f_theta.as_ptr(), inertia, f_hat.as_mut_ptr())
        };
        (f_hat, health)
    }

    /// Puts coefficients back where bits have flipped; the next step says so.
    pub fn check(&mut self) {
        // SAFETY: as above.
        unsafe { @name@_rust_check(self.0) }
    }
}

impl Drop for Filter {
    fn drop(&mut self) {
        TAKEN[self.0 as usize].store(false, Ordering::Release);
    }
}
