//! How the processor waits for a GPU: CUDA keeps a core busy with asking, unless it is told to sleep.

use cudarc::driver::CudaContext;
use cudarc::driver::sys::CUctx_flags;
use std::thread::Builder;

/// Has the threads that wait for `device` sleep until it is done, from now on and in the whole program.
///
/// # Errors
/// If the driver is older than that of CUDA 12.1, which brought the call, or refuses.
pub(super) fn let_threads_sleep(device: u32) -> Result<(), String> {
    // On a thread of its own: the call binds its thread to the device, and a driver without the call is a panic there.
    let spawned = Builder::new().name("cuda-waiting".to_owned()).spawn(move || {
        let context = CudaContext::new(device as usize)?;
        context.set_flags(CUctx_flags::CU_CTX_SCHED_BLOCKING_SYNC)
    });
    let thread = spawned.map_err(|error| error.to_string())?;
    match thread.join() {
        Ok(asked) => asked.map_err(|error| error.to_string()),
        Err(_) => Err("its driver is older than that of CUDA 12.1".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    /// A driver that writes down what it is asked for. Without `FLAGS` it is older than the call.
    const DRIVER: &str = r#"
        #include <stdio.h>
        #include <stdlib.h>
        static int asked(const char *what, int number) {
            FILE *file = fopen(getenv("ASKED"), "a");
            fprintf(file, "%s %d\n", what, number);
            return fclose(file);
        }
        int cuInit(unsigned flags) { return 0; }
        int cuDeviceGet(int *device, int ordinal) { *device = 40 + ordinal; return 0; }
        int cuDeviceGetAttribute(int *value, int attribute, int device) { *value = 0; return 0; }
        int cuDevicePrimaryCtxRetain(void **context, int device) {
            *context = (void *)1;
            return asked("retain", device);
        }
        int cuDevicePrimaryCtxRelease_v2(int device) { return asked("release", device); }
        int cuCtxGetCurrent(void **context) { *context = 0; return 0; }
        int cuCtxSetCurrent(void *context) { return 0; }
        #ifdef FLAGS
        int cuCtxSetFlags(unsigned flags) { return asked("flags", flags); }
        #endif
    "#;

    /// The test below runs it in a process of its own, which has loaded no other driver.
    #[test]
    fn whatever_the_driver_is_there_is_an_answer() {
        println!("answer: {:?}", let_threads_sleep(2));
    }

    /// What the test above prints with a driver that is built in `folder` with `options`. The driver writes what it is
    /// asked for to the file `asked` there.
    fn answer_with_a_driver(folder: &Path, options: &[&str]) -> String {
        let source = folder.join("driver.c");
        std::fs::write(&source, DRIVER).unwrap();
        let mut compile = Command::new("cc");
        compile
            .args(["-shared", "-fPIC", "-o"])
            .arg(folder.join("libcuda.so"))
            .arg(source)
            .args(options);
        let compiled = compile.status().unwrap();
        assert!(compiled.success());
        let mut ask = Command::new(std::env::current_exe().unwrap());
        let this = "onnx::waiting::tests::whatever_the_driver_is_there_is_an_answer";
        ask.args(["--exact", "--nocapture", this]);
        ask.env("LD_LIBRARY_PATH", folder).env("ASKED", folder.join("asked"));
        let ran = ask.output().unwrap();
        String::from_utf8(ran.stdout).unwrap()
    }

    #[test]
    fn the_driver_is_asked_to_let_threads_sleep_on_the_device() {
        let folder = tempfile::tempdir().unwrap();
        let answer = answer_with_a_driver(folder.path(), &["-DFLAGS"]);
        assert!(answer.contains("answer: Ok(())"), "{answer}");
        let asked = std::fs::read_to_string(folder.path().join("asked")).unwrap();
        // CU_CTX_SCHED_BLOCKING_SYNC is 4.
        assert_eq!(asked, "retain 42\nflags 4\nrelease 42\n");
    }

    #[test]
    fn a_driver_older_than_the_call_does_not_end_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let answer = answer_with_a_driver(folder.path(), &[]);
        assert!(answer.contains("older than that of CUDA 12.1"), "{answer}");
    }
}
