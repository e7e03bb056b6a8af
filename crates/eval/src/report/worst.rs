//! Draws the frames on which policies lost the most objects.

use crate::result::{ClipResult, FramePicture, WorstFrame};
use crate::run::shown_policies;
use crate::spec::short_label;
use crate::text::counted;
use albireo_core::geometry::Corners;
use albireo_vision::picture::{PictureFormat, read_picture_file};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use maud::{Markup, html};

/// The number of frames that are shown per policy.
const SHOWN: usize = 3;

/// Renders the frames of each policy that lost the most objects over all clips; a sentence if none were lost. `truth`
/// says what the objects are.
pub(super) fn frames(results: &[ClipResult], truth: &str) -> Markup {
    let lost = results.iter().filter(|result| !result.worst.is_empty());
    let policies = shown_policies(lost.map(|result| result.policy.as_str()));
    if policies.is_empty() {
        return html! {
            section {
                h2 { "Where it was lost" }
                p.legend {
                    "Nowhere: on no frame without the detector did a policy lose an object that the detector would have found."
                }
            }
        };
    }
    let mut drawn = results.iter().flat_map(|result| &result.worst);
    let without_pictures = drawn.all(|worst| worst.picture.is_none());
    html! {
        section {
            h2 { "Where it was lost" }
            p.legend {
                "Frames on which the detector did not run and most objects were lost: no box of the policy overlaps them by half \
                 (IoU 0.5), and one of the detector's would have. Drawn are " span.truth-word { (truth) } " and "
                span.found-word { "the policy's boxes" } ". At most " (SHOWN) " frames of a policy; of many policies, the first \
                 setting of each. Frames on which the detector ran are not among them, whatever it missed."
                @if without_pictures {
                    " The recording has detections and no pictures, so only boxes are drawn."
                }
            }
            @for (index, policy) in policies.into_iter().enumerate() {
                @if index == 0 {
                    h3 { (short_label(policy)) }
                    (frames_of(results, policy))
                } @else {
                    details {
                        summary { (short_label(policy)) }
                        (frames_of(results, policy))
                    }
                }
            }
        }
    }
}

fn frames_of(results: &[ClipResult], policy: &str) -> Markup {
    html! {
        div.frames {
            @for (result, worst) in worst_of(results, policy) {
                (picture(&place_of(result, worst), worst))
            }
        }
    }
}

/// Says where the frame is: `drive, frame 120 (4.8 s)`.
fn place_of(result: &ClipResult, worst: &WorstFrame) -> String {
    let seconds = result
        .frame_rate
        .map(|rate| format!(" ({:.1} s)", worst.frame as f64 / rate))
        .unwrap_or_default();
    format!("{}, frame {}{seconds}", result.clip, worst.frame)
}

/// The worst frames of a policy, each with the result of its clip.
fn worst_of<'a>(results: &'a [ClipResult], policy: &str) -> Vec<(&'a ClipResult, &'a WorstFrame)> {
    let mut frames = Vec::new();
    for result in results.iter().filter(|result| result.policy == policy) {
        frames.extend(result.worst.iter().map(|worst| (result, worst)));
    }
    frames.sort_by_key(|(_, worst)| std::cmp::Reverse(worst.lost));
    frames.truncate(SHOWN);
    frames
}

fn picture(place: &str, worst: &WorstFrame) -> Markup {
    let (width, height) = (worst.size.width, worst.size.height);
    // Lines are equally wide on pictures of all sizes.
    let stroke = f64::from(width) / 240.0;
    html! {
        figure.frame {
            svg viewBox={ "0 0 " (width) " " (height) } role="img"
                aria-label={ (worst.truth.len()) " objects, " (worst.found.len()) " boxes" } {
                rect.ground width=(width) height=(height) {}
                @if let Some(picture) = worst.picture.as_ref().and_then(data_uri) {
                    image href=(picture) width=(width) height=(height) {}
                }
                @for truth in &worst.truth { (rectangle("truth", truth, stroke)) }
                @for found in &worst.found { (rectangle("found", found, stroke)) }
            }
            figcaption {
                (place) ", state " (worst.state.as_str()) ": " (worst.lost) " of " (counted(worst.truth.len(), "object")) " lost"
            }
        }
    }
}

/// Encodes a picture as part of the page, so that the page can be opened anywhere. `None` if the picture cannot be read
/// or browsers do not show its format.
fn data_uri(picture: &FramePicture) -> Option<String> {
    let encoded = match picture {
        FramePicture::Encoded(encoded) => encoded.clone(),
        FramePicture::File(path) => read_picture_file(path).ok()?,
    };
    let kind = match encoded.format {
        PictureFormat::Jpeg => "jpeg",
        PictureFormat::Png => "png",
        _ => return None,
    };
    Some(format!(
        "data:image/{kind};base64,{}",
        BASE64_STANDARD.encode(&encoded.bytes)
    ))
}

fn rectangle(class: &str, corners: &Corners, stroke: f64) -> Markup {
    let round = |value: f64| (value * 10.0).round() / 10.0;
    html! {
        rect class=(class) x=(round(corners.x1)) y=(round(corners.y1))
            width=(round(corners.x2 - corners.x1).max(0.0)) height=(round(corners.y2 - corners.y1).max(0.0))
            stroke-width=(round(stroke)) {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::geometry::PictureSize;
    use albireo_core::policy::FrameState;
    use std::path::PathBuf;

    /// Draws a frame with one lost object, whose picture is in `file`.
    fn drawn_with(file: PathBuf) -> String {
        let worst = WorstFrame {
            frame: 3,
            state: FrameState::P,
            lost: 1,
            size: PictureSize::new(16, 16),
            truth: vec![Corners::default()],
            found: Vec::new(),
            picture: Some(FramePicture::File(file)),
        };
        picture("a clip", &worst).into_string()
    }

    #[test]
    fn boxes_are_drawn_over_their_picture() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("1.jpg");
        let encoder = jpeg_encoder::Encoder::new_file(&file, 80).unwrap();
        let rgb = jpeg_encoder::ColorType::Rgb;
        encoder.encode(&[0; 3 * 16 * 16], 16, 16, rgb).unwrap();
        let drawn = drawn_with(file);
        let place = |part: &str| drawn.find(part).expect(part);
        assert!(place("data:image/jpeg;base64,/9j/") < place("class=\"truth\""));
    }

    #[test]
    fn boxes_are_drawn_alone_if_their_picture_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let drawn = drawn_with(folder.path().join("gone.jpg"));
        assert!(!drawn.contains("<image"));
        assert!(drawn.contains("class=\"truth\""));
    }
}
