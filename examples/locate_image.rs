//! Where was a single image taken? The lens, about the attitude and the height of the camera are known.
//!
//!     cargo run --release --example locate_image -- photo.jpg fisheye-640 kid-2020 PITCH_DEG HEIGHT_M

use std::env::args;

use realitysim_config::{load_field, load_lens};
use realitysim_geometry::{Euler, Field};
use realitysim_log_input::decode;
use realitysim_tagging::single_image::{ImagePrior, MEASURED_HEIGHT_SIGMA_M};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = args().skip(1).collect();
    let [image, lens, field, pitch_deg, height_m] = &arguments[..] else {
        return Err("usage: locate_image IMAGE LENS FIELD PITCH_DEG HEIGHT_M".into());
    };
    let picture = decode::compressed(&std::fs::read(image)?)?;
    let field = Field::new(load_field(field)?)?;
    let prior = ImagePrior {
        lens: load_lens(lens)?.lens,
        attitude: Euler { yaw: 0.0, pitch: pitch_deg.parse::<f64>()?.to_radians(), roll: 0.0 },
        tilt_sigma_rad: 2.0_f64.to_radians(),
        height_m: height_m.parse()?,
        height_sigma_m: MEASURED_HEIGHT_SIGMA_M,
        initial: None,
        body: None,
    };
    let located = prior.locate(&prior.look(&picture, field.line_width()), &field, 1);
    println!("{:?}", located.fit());
    for hypothesis in &located.found {
        let pose = hypothesis.place();
        println!(
            "x {:.2} m, y {:.2} m, yaw {:.1} deg, log likelihood {:.1}",
            pose.x,
            pose.y,
            pose.yaw.to_degrees(),
            hypothesis.log_likelihood
        );
    }
    Ok(())
}
