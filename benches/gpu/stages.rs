//! Measures the milliseconds per frame by stage, and the frames per second with several cameras in one run.

use super::arguments::{Arguments, name_of, without_folder};
use super::page::{NONE, Page, median, ms};
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorNetwork, ElementType,
};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture, PixelLayout, decode};
use albireo_vision::screen::decoding_target;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// The numbers of pictures in one run of the model.
const BATCHES: [usize; 4] = [1, 2, 4, 8];

/// Writes both tables, with one row per model.
pub(crate) async fn write(
    page: &mut Page,
    arguments: &Arguments,
    frames: &[EncodedPicture],
    engines: &Path,
) -> anyhow::Result<()> {
    let (mut stages, mut batches) = (Vec::new(), Vec::new());
    for model in arguments.models()? {
        eprintln!("stages of {}", name_of(&model));
        let config = arguments.detector(&model, Some(engines));
        match one_by_one(arguments, &config, frames) {
            Ok(row) => stages.push(row),
            Err(error) => {
                let said = without_folder(format_args!("{error:#}"), &model);
                let mut row = vec![name_of(&model), said];
                row.resize(9, NONE.to_owned());
                stages.push(row);
                continue;
            }
        }
        let mut row = vec![name_of(&model)];
        let mut refusals = Vec::new();
        for batch in BATCHES {
            let config = DetectorConfig {
                batch_size: batch,
                ..config.clone()
            };
            match together(arguments, &config, frames).await {
                Ok(cell) => row.push(cell),
                Err(error) => {
                    row.push(NONE.to_owned());
                    let said = without_folder(format_args!("{error:#}"), &model);
                    refusals.push(format!("{batch}: {said}"));
                }
            }
        }
        // The others repeat the first.
        row.push(refusals.into_iter().next().unwrap_or_default());
        batches.push(row);
    }
    page.heading("Milliseconds per frame, by stage");
    page.text(
        "One picture after the other on one thread, medians. *Model* is one run as the node does it: the input copied to the \
         device, the kernels, the output copied back; the share of copying is given below, under *Copies alone*. Decoding and \
         letterbox are always the processor's. *Loading* includes the first runs.",
    );
    page.table(
        &[
            "model",
            "provider used",
            "input",
            "elements",
            "loading, s",
            "decode",
            "letterbox",
            "model",
            "head",
        ],
        &stages,
    );
    page.heading("Several cameras in one run");
    page.text(
        "As many cameras as the batch is large, each asking for its next picture when it has its answer \
         (`detector.batch_size`). In each cell the milliseconds of the model a picture, the frames per second of all cameras, \
         and the pictures that really shared a run.",
    );
    page.table(
        &[
            "model",
            "1",
            "2",
            "4",
            "8",
            "what could not be run, and why",
        ],
        &batches,
    );
    Ok(())
}

fn one_by_one(
    arguments: &Arguments,
    config: &DetectorConfig,
    frames: &[EncodedPicture],
) -> anyhow::Result<Vec<String>> {
    let start = Instant::now();
    let mut network = DetectorNetwork::open(config)?;
    let loading = start.elapsed().as_secs_f64();
    let mut times: [Vec<f64>; 4] = Default::default();
    let mut picture = Picture::default();
    for encoded in frames.iter().cycle().take(arguments.runs.into()) {
        let start = Instant::now();
        decode_for(&network, encoded, &mut picture)?;
        let decoding = start.elapsed();
        let prepared = network.preparation().prepare(&picture)?;
        let found = network.detect(&prepared)?;
        for (times, time) in
            times.iter_mut().zip([decoding, found.letterbox, found.model, found.head])
        {
            times.push(time.as_secs_f64() * 1e3);
        }
    }
    let element = network
        .signature()
        .inputs
        .first()
        .map_or(ElementType::Other(NONE.to_owned()), |input| {
            input.element.clone()
        });
    let mut row = vec![
        name_of(&config.model),
        // The provider that the session reports, which may differ from the requested one.
        network.provider().as_str().to_owned(),
        network.input_format().size.to_string(),
        element.to_string(),
        format!("{loading:.2}"),
    ];
    row.extend(times.iter().map(|times| ms(median(times))));
    Ok(row)
}

/// Decodes like the node for this model, without a screen.
fn decode_for(
    network: &DetectorNetwork,
    encoded: &EncodedPicture,
    into: &mut Picture,
) -> anyhow::Result<()> {
    let target = decoding_target(network.input_format(), None, encoded.size);
    let limits = FrameLimits::default();
    Ok(decode(
        encoded,
        &limits,
        PixelLayout::Rgb8,
        Some(target),
        into,
    )?)
}

async fn together(
    arguments: &Arguments,
    config: &DetectorConfig,
    frames: &[EncodedPicture],
) -> anyhow::Result<String> {
    let detector = DetectorHandle::start(config).await?;
    let target =
        |frame: &EncodedPicture| decoding_target(detector.preparation().format(), None, frame.size);
    // Decodes in advance, because only the detector is measured.
    let mut pictures = Vec::new();
    for frame in frames {
        let mut picture = Picture::default();
        let limits = FrameLimits::default();
        decode(
            frame,
            &limits,
            PixelLayout::Rgb8,
            Some(target(frame)),
            &mut picture,
        )?;
        pictures.push(Arc::new(picture));
    }
    let each = usize::from(arguments.runs).div_ceil(config.batch_size);
    let start = Instant::now();
    let cameras: Vec<_> = (0..config.batch_size)
        .map(|camera| {
            let detector = detector.clone();
            let mut own = pictures.clone();
            own.rotate_left(camera % pictures.len());
            tokio::spawn(async move {
                let mut answers = Vec::new();
                for number in 0..each {
                    let picture = Arc::clone(&own[number % own.len()]);
                    let answer = detector.detect(CameraSlot(camera), picture).await?;
                    answers.push((
                        answer.output.model.as_secs_f64() * 1e3,
                        f64::from(answer.pictures),
                    ));
                }
                anyhow::Ok(answers)
            })
        })
        .collect();
    let mut answers = Vec::new();
    for camera in cameras {
        answers.extend(camera.await??);
    }
    let rate = answers.len() as f64 / start.elapsed().as_secs_f64();
    detector.stop().await;
    let a_picture: Vec<_> = answers.iter().map(|(model, pictures)| model / pictures).collect();
    let shared: f64 =
        answers.iter().map(|(_, pictures)| pictures).sum::<f64>() / answers.len() as f64;
    Ok(format!(
        "{} ms, {rate:.1}/s, {shared:.1} shared",
        ms(median(&a_picture))
    ))
}
