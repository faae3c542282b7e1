import numpy as np
from naraha.systems.noise import generator_at


def test_a_sample_repeats_and_differs_from_every_other():
    draws = {(s, i): generator_at(s, i).standard_normal(4).tobytes() for s in range(20) for i in range(50)}
    assert len(set(draws.values())) == 1000
    assert generator_at(3, 7).standard_normal(4).tobytes() == draws[3, 7]


def test_successive_samples_are_independent_and_normal():
    noise = np.array([generator_at(1, i).standard_normal() for i in range(20000)])
    assert abs(noise.mean()) < 0.03
    assert abs(noise.std() - 1) < 0.02
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.03


def test_a_large_draw_does_not_run_into_the_next_sample():
    first = generator_at(1, 0).integers(0, 2**63, 100_000)
    assert not np.isin(generator_at(1, 1).integers(0, 2**63, 100), first).any()
