//! Compiles the generated C with the target's own compiler: `CC` and `AR`, or cc and ar.
use std::{env, path::PathBuf, process::Command};

fn run(command: &mut Command) {
    let status = command.status().unwrap_or_else(|error| panic!("{command:?}: {error}; set CC and AR"));
    assert!(status.success(), "{command:?} failed");
}

fn main() {
    let out = PathBuf::from(env::var("OUT_DIR").unwrap());
    let compiler = env::var("CC").unwrap_or_else(|_| "cc".into());
    let archiver = env::var("AR").unwrap_or_else(|_| "ar".into());
    let instances = env::var("@NAME@_INSTANCES").unwrap_or_else(|_| "1".into());
    let flags = env::var("CFLAGS").unwrap_or_default();
    let mut objects = Vec::new();
    for file in [@rust_files@] {
        let object = out.join(file).with_extension("o");
        run(Command::new(&compiler)
            .args(["-std=c99", "-O2", "-fPIC", "-c"])
            .args(flags.split_whitespace())
            .arg(format!("-D@NAME@_INSTANCES={instances}"))
            .arg(format!("src/{file}"))
            .arg("-o")
            .arg(&object));
        objects.push(object);
        println!("cargo:rerun-if-changed=src/{file}");
    }
    let archive = out.join("lib@name@_c.a");
    let _ = std::fs::remove_file(&archive);
    run(Command::new(&archiver).arg("crs").arg(&archive).args(&objects));
    println!("cargo:rerun-if-env-changed=@NAME@_INSTANCES");
    println!("cargo:rustc-env=@NAME@_INSTANCES={instances}");
    println!("cargo:rustc-link-search=native={}", out.display());
    println!("cargo:rustc-link-lib=static=@name@_c");
}
