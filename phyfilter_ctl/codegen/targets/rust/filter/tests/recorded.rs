//! The signals of test/@name@_vectors.h, which Python computed, and what the guard does with a bad one.
use @name@::{health, Filter, Real, DT, N_F, N_M, N_X};

fn rows<const N: usize>(name: &str) -> Vec<[Real; N]> {
    let text = include_str!("../test/@name@_vectors.h");
    let Some(at) = text.find(&format!("@name@_{name}[")) else { return Vec::new() };
    let body = &text[at + text[at..].find('=').unwrap()..];
    let body = &body[..body.find(';').unwrap()];
    let numbers: Vec<Real> = body
        .split(|letter: char| "{},=\n ".contains(letter))
        .filter_map(|word| word.trim_end_matches('f').parse().ok())
        .collect();
    numbers.chunks(N).map(|row| row.try_into().unwrap()).collect()
}

#[test]
fn numbers_are_those_of_python() {
    let (x, g, f_theta) = (rows::<N_X>("x"), rows::<N_X>("g"), rows::<N_F>("f_theta"));
    let (expected, inertia) = (rows::<N_F>("f_hat"), rows::<{ if N_M == 0 { 1 } else { N_M } }>("inertia"));
    assert_eq!(expected.len(), 40);
    let mut filter = Filter::new().unwrap();
    let mut worst: Real = 0.0;
    for k in 0..x.len() {
        let entries: Option<[Real; N_M]> = inertia.get(k).filter(|_| N_M > 0).map(|row| row[..].try_into().unwrap());
        let time = 1_000_000 + (1e6 * DT * k as f64).round() as u64;
        let (f_hat, health) = filter.step(time, &x[k], &g[k], &f_theta[k], entries.as_ref());
        assert_eq!(health & !health::LIMIT, 0);
        for i in 0..N_F {
            worst = worst.max((f_hat[i] - expected[k][i]).abs() / (1.0 + expected[k][i].abs()));
        }
    }
    assert!(worst <= 1e3 * Real::EPSILON, "{worst}");
    assert!(Filter::new().is_err()); // there is one, and it is taken
    let (held, health) = filter.step(2_000_000, &[Real::NAN; N_X], &g[0], &f_theta[0], None);
    assert_eq!(health, health::NOT_FINITE);
    assert!(held.iter().all(|value| value.is_finite()));
    filter.check();
    drop(filter);
    assert!(Filter::new().is_ok());
}
