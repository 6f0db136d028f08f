//! `unoinfer`: poses of objects against one reference view, evaluation on BOP datasets, scoring of result tables.

mod analyse;
mod bench;
mod calibrate;
mod calibrate_masks;
mod calibrate_proposals;
mod convert;
mod doctor;
mod estimate;
mod eval;
mod features;
mod mask_finder;
mod options;
mod progress;
mod proposals;
mod score;
mod segment;
mod segment_dataset;
mod verify;

use clap::{Parser, Subcommand};
use unopose_cli::tell;
use unopose_segment::SegmentError;

/// Exit code when the object is not in the image.
const NOT_FOUND: u8 = 3;

/// One-reference 6-DoF pose estimation of unseen objects (UNOPose).
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Estimate the pose of instances in query views relative to a reference view
    Estimate(estimate::EstimateArguments),
    /// Say what is wrong with views or a dataset: units, missing depth, registration, masks; exit code 1 when something is
    Doctor(doctor::DoctorArguments),
    /// Estimate every target of a BOP dataset and score the poses
    Eval(eval::EvalArguments),
    /// Measure every stage of the network on targets whose poses are known
    Analyse(analyse::AnalyseArguments),
    /// Fit the confidence of a checkpoint on synthetic pairs and store it in the checkpoint
    Calibrate(calibrate::CalibrateArguments),
    /// Measure colour encoders alone on pairs of views with known poses: area under the ROC curve of matching the same against
    /// different points of the surface
    Features(features::FeaturesArguments),
    /// Fit the score of masks that the program finds itself to synthetic images: the probability that a mask is the object of a
    /// reference, and the threshold below which the object is not there
    CalibrateMasks(calibrate_masks::CalibrateMasksArguments),
    /// Fit what ranks the proposals of a checkpoint of unotrain proposals to synthetic images, and store it in the checkpoint
    CalibrateProposals(calibrate_proposals::CalibrateProposalsArguments),
    /// Compare methods, classical ones and the network, on the targets of a BOP dataset
    Bench(bench::BenchArguments),
    /// Score a BOP result table
    Score(score::ScoreArguments),
    /// Find masks: everything in an image, an object of a reference, or the targets of a BOP dataset
    Segment(segment::SegmentArguments),
    /// Run a network on stored inputs and compare every stored tensor of another implementation
    Verify(verify::VerifyArguments),
    /// Describe a checkpoint
    Inspect(convert::InspectArguments),
    /// Write a checkpoint in another form
    Export(convert::ExportArguments),
}

fn main() -> std::process::ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .without_time()
        .log_internal_errors(false)
        .init();
    let done = match Arguments::parse().command {
        Command::Estimate(arguments) => estimate::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Analyse(arguments) => analyse::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Features(arguments) => features::run(&arguments),
        Command::CalibrateMasks(arguments) => calibrate_masks::run(&arguments),
        Command::CalibrateProposals(arguments) => calibrate_proposals::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Score(arguments) => score::run(&arguments),
        Command::Segment(arguments) => segment::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Inspect(arguments) => convert::inspect(&arguments),
        Command::Export(arguments) => convert::export(&arguments),
    };
    match done {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            tell!("error: {}", unopose_core::explain(error.as_ref()));
            match error.downcast_ref::<SegmentError>() {
                Some(SegmentError::NotFound { .. }) => std::process::ExitCode::from(NOT_FOUND),
                _ => std::process::ExitCode::FAILURE,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn arguments_refer_to_each_other_by_their_names() {
        super::Arguments::command().debug_assert();
    }
}
