//! Recognises ONNX Runtime's messages about exhausted memory or a lost GPU, and puts them into plain words.
//!
//! Its CUDA provider writes `CUDA failure 700: an illegal memory access was encountered ; GPU=0 ; hostname=… ; expr=…`
//! (`onnxruntime/core/providers/cuda/cuda_call.cc`), its arenas
//! `Failed to allocate memory for requested buffer of size …` (`core/framework/bfc_arena.cc`). The numbers are those of
//! `cudaError` in the CUDA Runtime API.

/// Phrases by which ONNX Runtime and the libraries it calls report exhausted memory: its arenas on the CPU and on a
/// GPU, C++, CUDA, cuBLAS and cuDNN.
const MEMORY_RAN_OUT: [&str; 8] = [
    "failed to allocate memory",
    "smaller than requested bytes",
    "failed to find a free memory block",
    "bad_alloc",
    "bad allocation",
    "out of memory",
    "status_alloc_failed",
    "allocation_failed",
];

/// The text that the CUDA provider writes before the number of an error.
const CUDA_FAILURE: &str = "cuda failure ";

/// CUDA's errors for an unavailable device.
const NO_DEVICE: [u32; 4] = [
    46,  // used exclusively by another process
    100, // no device at all
    101, // none with that number
    802, // not ready
];

/// CUDA's errors after which no call works any more in this process. The CUDA Runtime API states for most of them: "the
/// process must be terminated and relaunched" to use CUDA again.
const CONTEXT_IS_LOST: [u32; 13] = [
    214, // memory error that could not be corrected
    220, // the same of NVLink
    700, // illegal address
    702, // a kernel took too long
    709, // context destroyed
    710, // assertion in a kernel
    714, // hardware stack error
    715, // illegal instruction
    716, // misaligned address
    717, // invalid address space
    718, // invalid program counter
    719, // launch failure: what most hardware faults end as
    999, // unknown: what a GPU that fell off its bus ends as
];

/// The numbers of the CUDA errors in `message`.
fn cuda_failures(message: &str) -> Vec<u32> {
    let lower = message.to_lowercase();
    let mut numbers = Vec::new();
    for (at, phrase) in lower.match_indices(CUDA_FAILURE) {
        let rest = &lower[at + phrase.len()..];
        let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
        if let Ok(number) = digits.parse() {
            numbers.push(number);
        }
    }
    numbers
}

/// Returns true if `message`, from a session that worked before, means that this process has lost its GPU. The message
/// may be part of a longer sentence.
pub(crate) fn device_is_lost(message: &str) -> bool {
    cuda_failures(message)
        .iter()
        .any(|number| NO_DEVICE.contains(number) || CONTEXT_IS_LOST.contains(number))
}

/// Returns ONNX Runtime's message, preceded by its meaning and a remedy if these are known: the message itself speaks
/// of arenas and numbers.
pub(crate) fn in_words(message: &str) -> String {
    // Without its full stop, because callers continue the sentence.
    let message = message.trim_end().trim_end_matches('.');
    let lower = message.to_lowercase();
    let is_one_of = |numbers: &[u32]| cuda_failures(message).iter().any(|it| numbers.contains(it));
    if is_one_of(&CONTEXT_IS_LOST) {
        format!(
            "the GPU is lost to this process; if the device itself works (nvidia-smi), restarting the program \
             brings it back: {message}"
        )
    } else if is_one_of(&NO_DEVICE) {
        format!(
            "there is no such GPU that this process can use (nvidia-smi lists the GPUs, CUDA_VISIBLE_DEVICES \
             selects one): {message}"
        )
    } else if MEMORY_RAN_OUT.iter().any(|phrase| lower.contains(phrase)) {
        format!(
            "there is not enough memory for it; a smaller model or input size or detector.batch_size needs less, and \
             on a GPU other programs may hold it: {message}"
        )
    } else {
        message.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message as the CUDA provider composes it.
    fn cuda(number: u32, text: &str) -> String {
        format!(
            "Non-zero status code returned while running Conv node. Name:'conv1' Status Message: \
             CUDA failure {number}: {text} ; GPU=0 ; hostname=board ; expr=cudaStreamSynchronize(stream); "
        )
    }

    #[test]
    fn any_lack_of_memory_is_reported_in_plain_words() {
        for message in [
            "Failed to allocate memory for requested buffer of size 104857600",
            "Available memory of 1048576 is smaller than requested bytes of 26214400",
            "Failed to find a free memory block despite calling Extend. rounded_bytes=256",
            "std::bad_alloc",
            "CUDA failure 2: out of memory ; GPU=0 ; hostname=board ; expr=cudaMalloc((void**)&p, size); ",
            "CUBLAS failure 3: CUBLAS_STATUS_ALLOC_FAILED ; GPU=0 ; hostname=board ; expr=cublasCreate(&handle); ",
            "CUDNN failure 5003: CUDNN_STATUS_INTERNAL_ERROR_DEVICE_ALLOCATION_FAILED ; GPU=0 ; hostname=board",
        ] {
            let words = in_words(message);
            assert!(words.starts_with("there is not enough memory"), "{words}");
            assert!(words.contains(message.trim_end()), "{words}");
        }
    }

    #[test]
    fn a_device_that_is_lost_or_missing_is_reported_in_plain_words() {
        let lost = "the GPU is lost to this process";
        let missing = "there is no such GPU";
        for (said, number, text) in [
            (lost, 214, "uncorrectable ECC error encountered"),
            (lost, 700, "an illegal memory access was encountered"),
            (missing, 46, "devices are busy or unavailable"),
            (missing, 101, "invalid device ordinal"),
        ] {
            let words = in_words(&cuda(number, text));
            assert!(words.starts_with(said), "{words}");
            assert!(words.contains(text), "{words}");
        }
    }

    #[test]
    fn a_lost_device_is_recognised_also_within_our_sentence() {
        // From a session that worked before, the numbers of a missing GPU mean that it was lost.
        for number in [214, 700, 719, 999, 46, 100, 101] {
            let words = in_words(&cuda(number, "any text"));
            let sentence = format!("the run failed: {words}");
            assert!(device_is_lost(&sentence), "{sentence}");
        }
    }

    #[test]
    fn other_failures_are_not_taken_for_a_lost_device() {
        for message in [
            cuda(2, "out of memory"),
            in_words("std::bad_alloc"),
            cuda(1, "invalid argument"),
            cuda(7000, "of another library"),
            "CUDA failure".to_owned(),
            "CUDA failure 99999999999: too long a number".to_owned(),
            "CUDNN failure 700: of another library".to_owned(),
            "Got invalid dimensions for input".to_owned(),
        ] {
            assert!(!device_is_lost(&message), "{message}");
        }
    }

    #[test]
    fn a_message_without_a_known_meaning_stays_but_for_its_full_stop() {
        let words = in_words("Got invalid dimensions. ");
        assert_eq!(words, "Got invalid dimensions");
    }
}
