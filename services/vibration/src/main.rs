//! The vibration process: pieces of vibration trigger, the terrain's class goes out.

use messages::{Status, TerrainClass, Vibration};
use shell::Error;
use std::process::ExitCode;
use vibration::{Config, Model, VibrationClassifier};

fn main() -> ExitCode {
    shell::main(|shell| {
        let config = shell.config(Config::validate)?;
        let model = match &config.model {
            Some(path) => {
                Model::parse_bytes(&shell.read(path)?).map_err(|why| Error::data(format!("{path}: {why}")))?
            }
            None => Model::built_in(),
        };
        let mut classifier = VibrationClassifier::new(&config, model);
        let mut vibration = shell.input::<Vibration>("vibration")?;
        let class = shell.output::<TerrainClass>("class")?;
        let mut checked = false;
        shell.on_each(&mut classifier, &mut vibration, &class, |classifier, piece| {
            if !checked && piece.header.status == Status::OK {
                checked = true;
                if let Err(why) = classifier.check_fit(piece) {
                    match &config.model {
                        Some(path) => return Err(Error::config(format!("{path}: {why}"))),
                        None => shell::tell(format_args!("{why}; train a model: terrasense vibration train")),
                    }
                }
            }
            Ok(classifier.step(piece))
        })
    })
}
