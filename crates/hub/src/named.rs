//! Declares enums whose variants have the same name in JSON, text, tables and messages.

macro_rules! named {
    ($(#[$meta:meta])* pub enum $enum:ident { $($(#[$doc:meta])* $value:ident = $name:literal,)+ }) => {
        $(#[$meta])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
            utoipa::ToSchema,
        )]
        #[serde(rename_all = "snake_case")]
        pub enum $enum {
            $($(#[$doc])* $value,)+
        }

        impl $enum {
            /// All variants, in order.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$value,)+];

            /// Its name.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $name,)+
                }
            }

            /// The variant with that name.
            pub fn named(name: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|one| one.name() == name)
            }
        }

        impl std::fmt::Display for $enum {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

pub(crate) use named;

#[cfg(test)]
mod tests {
    use crate::presence::PresenceState;
    use crate::tuning::gate::Verdict;
    use crate::tuning::metric::{Figure, Metric};
    use crate::tuning::outcome::Outcome;
    use crate::tuning::run::{Command, Phase, What};
    use serde::Serialize;

    fn same<T: Copy + Serialize>(all: &[T], name: fn(T) -> &'static str) {
        for one in all {
            assert_eq!(serde_json::to_value(one).unwrap(), name(*one));
        }
    }

    #[test]
    fn a_name_is_the_same_in_json_and_in_texts() {
        same(&Metric::ALL, Metric::name);
        same(&Figure::ALL, Figure::name);
        same(&PresenceState::ALL, PresenceState::name);
        same(&Command::ALL, Command::name);
        same(&Phase::ALL, Phase::name);
        same(&What::ALL, What::name);
        same(&Outcome::ALL, Outcome::name);
        same(&Verdict::ALL, Verdict::name);
    }
}
