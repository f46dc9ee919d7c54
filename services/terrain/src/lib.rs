//! Fusion: everything known of the ground after one estimation cycle, in one sample.
//!
//! A part is what its stage last said with conviction. It is valid until it is too old; how old it is, by sensor time,
//! always stands beside it.

mod strength;

use messages::{Message, Resumable, Sinkage, Soil, Status, Terrain, TerrainClass};
use serde::Deserialize;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// How long each part may be used after it was measured.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Greatest age of a valid sinkage [s].
    pub sinkage_age_max_s: f64,
    /// Greatest age of valid soil parameters and of a valid strength [s].
    pub soil_age_max_s: f64,
    /// Greatest age of a valid class [s], from the end of its window.
    pub class_age_max_s: f64,
}

impl Default for Config {
    /// At the 5 to 10 cm/s of a rover: within its wheel's contact patch, half a wheel on, and about a wheel on.
    fn default() -> Self {
        Self {
            sinkage_age_max_s: 0.5,
            soil_age_max_s: 2.0,
            class_age_max_s: 5.0,
        }
    }
}

impl Config {
    /// Whether the values make sense.
    ///
    /// # Errors
    /// The key, and what would be right.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let ages = [
            ("sinkage_age_max_s", self.sinkage_age_max_s),
            ("soil_age_max_s", self.soil_age_max_s),
            ("class_age_max_s", self.class_age_max_s),
        ];
        match ages.iter().find(|(_, age)| !(*age > 0.0 && *age <= 3600.0)) {
            Some((key, age)) => Err((*key, format!("must be above 0 and at most 3600, is {age}"))),
            None => Ok(()),
        }
    }
}

/// Holds the last word of each stage and joins them, once a cycle.
#[derive(Clone, Debug)]
pub struct TerrainFusion {
    config: Config,
    sinkage: Option<Sinkage>,
    sinkage_status: Status,
    soil: Option<Soil>,
    class: Option<TerrainClass>,
    class_status: Status,
}

impl TerrainFusion {
    /// Knows nothing yet. `config` is a valid one.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            sinkage: None,
            sinkage_status: Status::NO_DATA,
            soil: None,
            class: None,
            class_status: Status::NO_DATA,
        }
    }

    /// One estimation cycle: the soil's sample that ends it, with all that is known beside it.
    pub fn step(&mut self, soil: &Soil) -> Terrain {
        let trigger = *soil;
        match trigger.header.status {
            Status::OK | Status::UNCERTAIN | Status::NOT_OBSERVABLE => self.soil = Some(trigger),
            // The estimator takes back what it said: of another soil, or not of one that its model describes.
            Status::WARMING_UP | Status::LACK_OF_FIT => self.soil = None,
            _ => {}
        }
        let mut terrain = Terrain::unknown(trigger.header);
        terrain.soil_status = trigger.header.status;
        self.add_sinkage(&mut terrain);
        self.add_soil(&mut terrain);
        self.add_class(&mut terrain);
        let status = match terrain.valid {
            _ if trigger.header.status == Status::BAD_SAMPLE => Status::INPUT_REJECTED,
            ALL => Status::OK,
            0 => Status::NO_DATA,
            _ => Status::INCOMPLETE,
        };
        terrain.header = trigger.header.answer(status);
        terrain
    }

    /// Takes in a sinkage of this cycle or of an earlier one.
    pub fn observe_sinkage(&mut self, sinkage: &Sinkage) {
        self.sinkage_status = sinkage.header.status;
        if sinkage.header.status.is_answer() {
            self.sinkage = Some(*sinkage);
        }
    }

    /// Takes in a class of the terrain.
    pub fn observe_class(&mut self, class: &TerrainClass) {
        let status = class.header.status;
        self.class_status = status;
        if status.is_answer() || status == Status::UNKNOWN_TERRAIN {
            self.class = Some(*class);
        }
    }

    fn add_sinkage(&self, terrain: &mut Terrain) {
        terrain.sinkage_status = self.sinkage_status;
        let Some(sinkage) = &self.sinkage else { return };
        terrain.sinkage_m = sinkage.sinkage_m;
        terrain.sinkage_sigma_m = sinkage.sinkage_sigma_m;
        terrain.entry_rad = sinkage.entry_rad;
        terrain.entry_sigma_rad = sinkage.entry_sigma_rad;
        terrain.sinkage_age_ns = age_ns(terrain, sinkage.header.taken_ns);
        let known = sinkage.sinkage_m.is_finite() && sinkage.entry_rad.is_finite();
        if known && is_young(terrain.sinkage_age_ns, self.config.sinkage_age_max_s) {
            terrain.valid |= Terrain::SINKAGE;
        }
    }

    fn add_soil(&self, terrain: &mut Terrain) {
        let Some(soil) = &self.soil else { return };
        terrain.cohesion_pa = soil.cohesion_pa;
        terrain.cohesion_sigma_pa = soil.cohesion_sigma_pa;
        terrain.friction_rad = soil.friction_rad;
        terrain.friction_sigma_rad = soil.friction_sigma_rad;
        terrain.cohesion_friction_covariance_pa_rad = soil.cohesion_friction_covariance_pa_rad;
        terrain.pressure_pa = soil.pressure_pa;
        terrain.slip = soil.slip;
        let strength = strength::of(soil);
        terrain.strength_pa = strength.value_pa;
        terrain.strength_sigma_pa = strength.sigma_pa;
        terrain.soil_age_ns = age_ns(terrain, soil.header.taken_ns);
        if !is_young(terrain.soil_age_ns, self.config.soil_age_max_s) {
            return;
        }
        let known = soil.cohesion_pa.is_finite() && soil.friction_rad.abs() < std::f64::consts::FRAC_PI_2;
        if soil.header.status.is_answer() && known {
            terrain.valid |= Terrain::SOIL;
        }
        if strength.holds {
            terrain.valid |= Terrain::STRENGTH;
        }
    }

    fn add_class(&self, terrain: &mut Terrain) {
        terrain.class_status = self.class_status;
        let Some(class) = &self.class else { return };
        let index = class.class as usize;
        let known = class.class < class.class_count && index < class.labels.len();
        if known {
            terrain.class = class.class;
            terrain.class_label = class.labels[index];
            terrain.class_probability = class.probability[index];
        }
        terrain.class_metric = class.metric;
        terrain.class_age_ns = age_ns(terrain, class.start_ns.saturating_add(class.window_ns));
        terrain.unknown = u32::from(!known || class.unknown != 0);
        let decided = class.header.status == Status::OK && terrain.unknown == 0;
        if decided && is_young(terrain.class_age_ns, self.config.class_age_max_s) {
            terrain.valid |= Terrain::CLASS;
        }
    }
}

const ALL: u32 = Terrain::SINKAGE | Terrain::SOIL | Terrain::STRENGTH | Terrain::CLASS;

/// Sensor time from `taken_ns` to this cycle's instant.
fn age_ns(terrain: &Terrain, taken_ns: u64) -> u64 {
    terrain.header.taken_ns.saturating_sub(taken_ns)
}

fn is_young(age_ns: u64, age_max_s: f64) -> bool {
    age_ns as f64 <= age_max_s * 1e9
}

/// What the fusion remembers, as plain bytes. A sample that is not known is zeros, and its flag 0.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct State {
    sinkage: Sinkage,
    soil: Soil,
    class: TerrainClass,
    known: [u32; 3],
    sinkage_status: Status,
    class_status: Status,
    unused: u32,
}

fn known<T: Message>(flag: u32, sample: T) -> Result<Option<T>, &'static str> {
    match flag {
        0 => Ok(None),
        _ => sample.check().map(|()| Some(sample)),
    }
}

impl Resumable for TerrainFusion {
    fn state_bytes(&self) -> usize {
        size_of::<State>()
    }

    fn save(&self, state: &mut [u8]) {
        let present = [self.sinkage.is_some(), self.soil.is_some(), self.class.is_some()];
        let mut all = State::new_zeroed();
        all.known = present.map(u32::from);
        all.sinkage_status = self.sinkage_status;
        all.class_status = self.class_status;
        self.sinkage.iter().for_each(|known| all.sinkage = *known);
        self.soil.iter().for_each(|known| all.soil = *known);
        self.class.iter().for_each(|known| all.class = *known);
        state.copy_from_slice(all.as_bytes());
    }

    fn restore(&mut self, state: &[u8]) -> Result<(), &'static str> {
        let all = State::read_from_bytes(state).map_err(|_| "is of another length")?;
        if all.sinkage_status.word().is_none() || all.class_status.word().is_none() {
            return Err("holds a status that has no meaning");
        }
        let [sinkage, soil, class] = all.known;
        let parts = (
            known(sinkage, all.sinkage)?,
            known(soil, all.soil)?,
            known(class, all.class)?,
        );
        (self.sinkage, self.soil, self.class) = parts;
        self.sinkage_status = all.sinkage_status;
        self.class_status = all.class_status;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Header, Message, label};

    fn at(taken_ns: u64, status: Status) -> Header {
        Header {
            taken_ns,
            sequence: taken_ns / 10,
            status,
            ..Header::default()
        }
    }

    fn sand(header: Header) -> Soil {
        Soil {
            cohesion_pa: 1000.0,
            friction_rad: std::f64::consts::FRAC_PI_4,
            pressure_pa: 5000.0,
            strength_pa: 6000.0,
            strength_sigma_pa: 30.0,
            ..Soil::unknown(header)
        }
    }

    fn valid_after(soil: &Soil) -> u32 {
        TerrainFusion::new(Config::default()).step(soil).valid
    }

    #[test]
    fn a_strength_that_contradicts_cohesion_and_friction_is_not_valid() {
        let soil = sand(at(0, Status::OK));
        assert_eq!(valid_after(&soil), Terrain::SOIL | Terrain::STRENGTH);
        let other_pa = 6000.0 + 3.5 * 30.0;
        assert_eq!(
            valid_after(&Soil {
                strength_pa: other_pa,
                ..soil
            }),
            Terrain::SOIL
        );
    }

    #[test]
    fn where_cohesion_and_friction_cannot_be_told_apart_the_estimators_strength_stands() {
        let soil = Soil {
            strength_pa: 5900.0,
            ..sand(at(0, Status::NOT_OBSERVABLE))
        };
        let terrain = TerrainFusion::new(Config::default()).step(&soil);
        assert_eq!((terrain.strength_pa, terrain.valid), (5900.0, Terrain::STRENGTH));
    }

    #[test]
    fn a_friction_angle_of_ninety_degrees_is_no_friction_angle() {
        let soil = Soil {
            friction_rad: std::f64::consts::FRAC_PI_2,
            strength_pa: f64::NAN,
            ..sand(at(0, Status::OK))
        };
        assert_eq!(valid_after(&soil), 0);
    }

    #[test]
    fn a_part_from_the_future_is_of_this_cycle() {
        let mut fusion = TerrainFusion::new(Config::default());
        fusion.observe_sinkage(&Sinkage::unknown(at(u64::MAX, Status::OK)));
        let terrain = fusion.step(&sand(at(7, Status::OK)));
        assert_eq!((terrain.sinkage_age_ns, terrain.header.taken_ns), (0, 7));
    }

    #[test]
    fn a_class_that_the_model_does_not_have_has_no_name() {
        let mut class = TerrainClass::undecided(at(0, Status::OK));
        class.unknown = 0;
        class.labels[0] = label("sand");
        for (index, count) in [(0, 0), (16, 17), (u32::MAX, u32::MAX)] {
            (class.class, class.class_count) = (index, count);
            let mut fusion = TerrainFusion::new(Config::default());
            fusion.observe_class(&class);
            let terrain = fusion.step(&sand(at(0, Status::OK)));
            assert_eq!((terrain.class_text(), terrain.unknown), ("", 1));
            assert_eq!(terrain.valid & Terrain::CLASS, 0);
        }
    }

    #[test]
    fn the_answer_to_any_believable_soil_is_believable() {
        let extremes = [f64::NAN, 0.0, -1e9, 1e9, 1.57, -1.6, 2.0];
        for cohesion_pa in extremes {
            for friction_rad in extremes {
                for pressure_pa in extremes {
                    for status in 0..14 {
                        let soil = Soil {
                            cohesion_pa,
                            friction_rad,
                            pressure_pa,
                            ..sand(at(0, Status(status)))
                        };
                        if soil.check().is_ok() {
                            let terrain = TerrainFusion::new(Config::default()).step(&soil);
                            assert_eq!(terrain.check(), Ok(()), "{soil:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_impossible_age_is_refused_by_its_key() {
        for age in [0.0, -1.0, 3601.0, f64::NAN, f64::INFINITY] {
            let config = Config {
                soil_age_max_s: age,
                ..Config::default()
            };
            assert_eq!(config.validate().map_err(|(key, _)| key), Err("soil_age_max_s"));
        }
        assert_eq!(Config::default().validate(), Ok(()));
    }
}
