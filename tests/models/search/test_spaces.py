"""The paper's search spaces as configurations of the families."""

import pytest

from taxel.errors import SettingsError
from taxel_models.families.registry import family, resolve
from taxel_models.search.search_settings import SearchSettings
from taxel_models.search.spaces import LEARNING_RATES, search_space


@pytest.mark.parametrize("name", ["xgb", "ffnn", "transformer"])
def test_every_configuration_is_one_that_the_family_takes(name: str) -> None:
    space = search_space(name)
    configurations = space.build(frozenset())
    configurations.seed(0)
    for configuration in configurations.sample_configuration(60):
        decoded = space.decode(dict(configuration))
        taken = resolve(family(name), 1, decoded).model_dump(mode="json")
        assert decoded.items() <= taken.items()


@pytest.mark.parametrize("name", ["xgb", "ffnn", "transformer"])
def test_the_published_choice_lies_in_the_space(name: str) -> None:
    """Every published hyperparameter is one that a search could have found."""
    space = search_space(name)
    configurations = space.build(frozenset())
    for combination in range(1, 9):
        chosen = dict(family(name).paper_hyperparameters(combination))
        if name == "ffnn":
            widths, activations = chosen.pop("neurons"), chosen.pop("activations")
            chosen["layers"] = len(widths)
            for number, (width, activation) in enumerate(zip(widths, activations, strict=True), start=1):
                assert width % 10 == 0
                chosen |= {f"tens_{number}": width // 10, f"activation_{number}": activation}
        for hyperparameter, value in chosen.items():
            assert configurations[hyperparameter].legal_value(value), (combination, hyperparameter, value)


def test_a_feed_forward_network_has_as_many_widths_as_layers() -> None:
    space = search_space("ffnn")
    configurations = space.build(frozenset())
    configurations.seed(1)
    lengths = set()
    for configuration in configurations.sample_configuration(100):
        chosen = space.decode(dict(configuration))
        assert len(chosen["neurons"]) == len(chosen["activations"]) == configuration["layers"]
        assert all(50 <= width <= 1000 and width % 10 == 0 for width in chosen["neurons"])
        assert ("leaky_relu_negative_slope" in chosen) == ("leakyrelu" in chosen["activations"])
        lengths.add(len(chosen["neurons"]))
    assert lengths == set(range(4, 13))


def test_learning_rates_are_a_digit_times_a_power_of_ten() -> None:
    assert len(LEARNING_RATES) == 36
    assert sorted(LEARNING_RATES) == LEARNING_RATES
    assert (LEARNING_RATES[0], LEARNING_RATES[-1]) == (0.00001, 0.09)


def test_what_is_set_is_not_searched() -> None:
    configurations = search_space("xgb").build(frozenset({"eta", "max_bin"}))
    assert "eta" not in configurations
    assert "gamma" in configurations


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"family": "network-b"}, "has no search space: expected one of xgb, ffnn, transformer"),
        ({"family": "xgb", "held": {"etaa": 1}}, "etaa"),
        ({"family": "ffnn", "held": {"epochs": 3}}, "--set epochs"),
        ({"family": "xgb", "trials": 0}, "trials"),
        ({"family": "ffnn", "epochs": 3, "least_epochs": 5}, "least_epochs 5 is above epochs 3"),
    ],
)
def test_what_cannot_be_searched_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        SearchSettings.of([], **settings)
