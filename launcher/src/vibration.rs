//! `vibration`: the terrain classifier, trained and tried on recordings.

mod plots;
mod recordings;
mod report;

use clap::{Args, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use plots::Figures;
use recordings::{RATE_TOLERANCE, Recordings};
use report::Report;
use serde_json::json;
use shell::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vibration::Model;
use vibration::calibrate::Validated;
use vibration::evaluate::{Judged, evaluate};
use vibration::model::{Filtering, Method, Rejecting};
use vibration::score::Scored;
use vibration::train::{Setup, Trained, train};
use vibration::warnings::warnings;

/// How far the length of a window may differ from the model's, relative to it.
const TOLERANCE: f64 = 0.02;
/// Steps of a progress bar.
const BAR_STEPS: u64 = 1000;

/// `terrasense vibration`
#[derive(Debug, Subcommand)]
pub enum VibrationCommand {
    /// Trains a model on labelled recordings and says how it does on runs left out of the training.
    Train(TrainArguments),
    /// Tries a model on labelled recordings and writes what it says of each window.
    Evaluate(EvaluateArguments),
}

/// `terrasense vibration train`
#[derive(Debug, Args)]
pub struct TrainArguments {
    /// A folder with recordings.csv (file,class,run) and the CSV or WAV files that it lists.
    #[arg(value_name = "RECORDINGS")]
    recordings: PathBuf,
    /// The model file to write.
    #[arg(long, value_name = "MODEL.TOML")]
    out: PathBuf,
    /// Length of a window [s].
    #[arg(long, default_value_t = 1.0)]
    window_s: f64,
    /// How windows are decided: `coupled` fits its spectra, components and probabilities to the recordings, `paper` takes six
    /// principal components and a band of one standard deviation.
    #[arg(long, value_enum, default_value_t = MethodArgument::Coupled)]
    method: MethodArgument,
    #[command(flatten)]
    choices: Choices,
}

/// `terrasense vibration evaluate`
#[derive(Debug, Args)]
pub struct EvaluateArguments {
    /// The model file.
    #[arg(value_name = "MODEL.TOML")]
    model: PathBuf,
    /// A folder with recordings.csv (file,class,run) and the CSV or WAV files that it lists.
    #[arg(value_name = "RECORDINGS")]
    recordings: PathBuf,
    /// The table to write: a row a window.
    #[arg(long, value_name = "PREDICTIONS.CSV")]
    out: PathBuf,
    /// Refuse the model if it was trained for another length of windows [s].
    #[arg(long)]
    window_s: Option<f64>,
    /// Refuse the model if it was trained by another method.
    #[arg(long, value_enum)]
    method: Option<MethodArgument>,
    #[command(flatten)]
    choices: Choices,
}

#[derive(Debug, Args)]
struct Choices {
    /// The channels, with commas between them; `acceleration_*` is all that begin so. [default: all but the speed]
    #[arg(long, value_delimiter = ',')]
    channels: Vec<String>,
    /// Whether the windows before count. [default: hmm, or as the model was trained]
    #[arg(long, value_enum)]
    filter: Option<FilterArgument>,
    /// Whether a class may be rejected. [default: calibrated, or as the model was trained]
    #[arg(long, value_enum)]
    reject: Option<RejectArgument>,
    /// Draw Figures 12, 13 and 14 of the paper into this folder, as SVG.
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum MethodArgument {
    Coupled,
    Paper,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FilterArgument {
    None,
    Hmm,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RejectArgument {
    None,
    Calibrated,
}

impl MethodArgument {
    fn method(self) -> Method {
        match self {
            Self::Coupled => Method::Coupled,
            Self::Paper => Method::Paper,
        }
    }
}

impl Choices {
    fn filtering(&self) -> Option<Filtering> {
        self.filter.map(|filter| match filter {
            FilterArgument::None => Filtering::None,
            FilterArgument::Hmm => Filtering::Hmm,
        })
    }

    fn rejecting(&self) -> Option<Rejecting> {
        self.reject.map(|reject| match reject {
            RejectArgument::None => Rejecting::None,
            RejectArgument::Calibrated => Rejecting::Calibrated,
        })
    }
}

/// Runs one of the commands.
pub fn run(command: &VibrationCommand) -> Result<ExitCode, Error> {
    match command {
        VibrationCommand::Train(arguments) => run_train(arguments),
        VibrationCommand::Evaluate(arguments) => run_evaluate(arguments),
    }
}

/// What is going on, drawn on a terminal only.
struct Progress(ProgressBar);

impl Progress {
    fn begin() -> Self {
        let style = ProgressStyle::with_template("{msg:16} {wide_bar} {percent} %, {eta} left");
        let bar = ProgressBar::new(BAR_STEPS).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Self(bar)
    }

    fn show(&self, what: &'static str, share: f64) {
        if self.0.message() != what {
            self.0.set_message(what);
            self.0.reset();
        }
        self.0.set_position((share * BAR_STEPS as f64) as u64);
    }
}

fn run_train(arguments: &TrainArguments) -> Result<ExitCode, Error> {
    let progress = Progress::begin();
    let read = recordings::read(
        &arguments.recordings,
        &arguments.choices.channels,
        &[],
        &mut |what, share| progress.show(what, share),
    )?;
    let setup = setup(arguments, &read)?;
    let trained = train(&setup, &read.all, &mut |what, share| progress.show(what, share))
        .map_err(|what| Error::data(format!("{}: {what}", arguments.recordings.display())))?;
    progress.0.finish_and_clear();
    let text = trained.model.to_text().map_err(Error::internal)?;
    write(&arguments.out, &text)?;
    if arguments.choices.plots.is_some() {
        let judged = evaluate(&trained.model, &read.all, None, None, &mut |_| {});
        draw(&arguments.choices, &trained.model, &read, &judged)?;
    }
    let report = Report::new(&trained.model.labels, &decided(&trained));
    let warned = warnings(&setup, &read.all, &trained);
    if arguments.choices.json {
        let summary = json!({
            "model": arguments.out,
            "training": trained.model.training,
            "choice": trained.choice,
            "lag_s": trained.model.filter.lag_s,
            "left_out": report.to_json(),
            "warnings": warned,
        });
        println!("{summary:#}");
        return Ok(ExitCode::SUCCESS);
    }
    println!("{}", trained.model.training);
    println!("chosen by cross-validation: {}\n", trained.choice);
    print!("Windows of runs left out of the training:\n{report}");
    println!(
        "with the filter, a change of terrain is named after {:.1} s (median)\n",
        trained.model.filter.lag_s
    );
    warned.iter().for_each(|warning| println!("warning: {warning}"));
    println!("wrote {}", arguments.out.display());
    Ok(ExitCode::SUCCESS)
}

fn setup(arguments: &TrainArguments, read: &Recordings) -> Result<Setup, Error> {
    let window_samples = (arguments.window_s * read.rate_hz).round();
    if !(4.0..=vibration::model::WINDOW_SAMPLES_MAX as f64).contains(&window_samples) {
        return Err(Error::usage(format!(
            "--window-s {} is {window_samples} samples at {} Hz; a window needs 4 to {}",
            arguments.window_s,
            read.rate_hz,
            vibration::model::WINDOW_SAMPLES_MAX
        )));
    }
    Ok(Setup {
        labels: read.labels.clone(),
        channels: read.channels.clone(),
        rate_hz: read.rate_hz,
        window_samples: window_samples as usize,
        method: arguments.method.method(),
        filtering: arguments.choices.filtering().unwrap_or(Filtering::Hmm),
        rejecting: arguments.choices.rejecting().unwrap_or(Rejecting::Calibrated),
    })
}

/// The decisions on windows left out, as the model would have made them.
fn decided(trained: &Trained) -> Vec<Scored> {
    let one = |window: &Validated| {
        let mut scored = match trained.model.filtering {
            Filtering::None => window.alone,
            Filtering::Hmm => window.filtered,
        };
        scored.unknown &= trained.model.rejecting == Rejecting::Calibrated;
        scored
    };
    trained.validated.iter().map(one).collect()
}

fn run_evaluate(arguments: &EvaluateArguments) -> Result<ExitCode, Error> {
    let model = load(&arguments.model)?;
    check_wishes(arguments, &model)?;
    let progress = Progress::begin();
    let read = recordings::read(
        &arguments.recordings,
        &model.channels,
        &model.labels,
        &mut |what, share| progress.show(what, share),
    )?;
    if (read.rate_hz - model.rate_hz).abs() > RATE_TOLERANCE * model.rate_hz {
        return Err(Error::data(format!(
            "{}: sampled at {} Hz; the model was trained at {} Hz",
            arguments.recordings.display(),
            read.rate_hz,
            model.rate_hz
        )));
    }
    let (filtering, rejecting) = (arguments.choices.filtering(), arguments.choices.rejecting());
    let judged = evaluate(&model, &read.all, filtering, rejecting, &mut |share| {
        progress.show("evaluation", share);
    });
    progress.0.finish_and_clear();
    write(&arguments.out, &report::predictions(&model, &read, &judged))?;
    draw(&arguments.choices, &model, &read, &judged)?;
    let scored: Vec<Scored> = judged.iter().filter_map(|window| window.scored(&read.all)).collect();
    let report = Report::of_known(&read.labels, model.labels.len(), &scored);
    let left_out = report::left_out(&judged);
    if arguments.choices.json {
        let summary = json!({
            "predictions": arguments.out,
            "windows": judged.len(),
            "not_scored": left_out,
            "scored": report.to_json(),
        });
        println!("{summary:#}");
        return Ok(ExitCode::SUCCESS);
    }
    print!("{report}");
    for (status, count) in left_out {
        println!("not scored: {count} windows, {status}");
    }
    println!("wrote {}", arguments.out.display());
    Ok(ExitCode::SUCCESS)
}

fn draw(choices: &Choices, model: &Model, read: &Recordings, judged: &[Judged]) -> Result<(), Error> {
    match &choices.plots {
        Some(folder) => Figures { model, read, judged }.draw(folder),
        None => Ok(()),
    }
}

fn load(path: &Path) -> Result<Model, Error> {
    let read = fs::read(path).map_err(|error| error.to_string());
    read.and_then(|bytes| Model::parse_bytes(&bytes))
        .map_err(|what| Error::data(format!("{}: {what}", path.display())))
}

/// A model is trained for one length of windows, one method and some channels: another wish needs another model.
fn check_wishes(arguments: &EvaluateArguments, model: &Model) -> Result<(), Error> {
    let refused = |what: String| {
        Err(Error::data(format!(
            "{}: the model was trained for {what}; train another one",
            arguments.model.display()
        )))
    };
    let wished_s = arguments.window_s.unwrap_or(model.window_s());
    if (wished_s - model.window_s()).abs() > TOLERANCE * model.window_s() {
        return refused(format!("windows of {} s, not {wished_s} s", model.window_s()));
    }
    if arguments.method.is_some_and(|method| method.method() != model.method) {
        return refused(format!("the method {:?}", model.method).to_lowercase());
    }
    let fits = |name: &String, pattern: &String| match pattern.strip_suffix('*') {
        Some(beginning) => name.starts_with(beginning),
        None => name == pattern,
    };
    let wished = &arguments.choices.channels;
    let asked = |name: &String| wished.iter().any(|pattern| fits(name, pattern));
    let known = |pattern: &String| model.channels.iter().any(|name| fits(name, pattern));
    let same = model.channels.iter().all(asked) && wished.iter().all(known);
    if !wished.is_empty() && !same {
        return refused(format!("the channels {}", model.channels.join(", ")));
    }
    Ok(())
}

/// Writes a file that appears when it is complete.
fn write(path: &Path, text: &str) -> Result<(), Error> {
    let partial = path.with_extension("partial");
    fs::write(&partial, text)
        .and_then(|()| fs::rename(&partial, path))
        .map_err(|error| Error::data(format!("{}: {error}", path.display())))
}
