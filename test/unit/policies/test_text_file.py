"""The C++ header acts like the policies that it reads."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies import text_file
from rkhs_ros.policies.text_file import FIRST_LINE, HEADER, policy_text
from rkhs_ros.rkhs.kernels import COMPOSITIONS, LEAVES
from test.unit.policies.exported import EACH_LEAF, INPUTS, KERNELS, STEPS, acted, random_episode, small_policy

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("g++") is None, reason="there is no compiler")]
LINES = 170  # of the header
PROGRAM = """
#include <cmath>
#include <cstdio>
#include <iostream>
#include "rkhs_policy.hpp"
int main(int count, char** files) try {  // acts in two episodes with each policy, on the same observations from stdin
  std::vector<double> numbers;
  for (double number; std::cin >> number;) numbers.push_back(number < 1e300 ? number : NAN);  // streams read no NAN
  for (int i = 1; i < count; ++i) {
    rkhs::Policy policy(files[i]);
    for (int episode = 0; episode < 2; ++episode) {
      policy.reset();
      for (auto at = numbers.begin(); at != numbers.end(); at += 4)
        for (double action : policy({at, at + 4})) std::printf("%.17g ", action);
    }
    std::printf("\\n");
  }
} catch (const std::exception& error) {
  std::puts(error.what());
  return 1;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("program")
    (folder / "main.cpp").write_text(PROGRAM)
    options = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror"]
    subprocess.run(["g++", *options, f"-I{HEADER.parent}", "main.cpp", "-o", "main"], cwd=folder, check=True)
    return folder / "main"


def run(program: Path, *files: Path) -> subprocess.CompletedProcess[str]:
    numbers = " ".join(map(repr, random_episode().ravel().tolist()))
    return subprocess.run([program, *files], input=numbers, capture_output=True, text=True)


def test_all_registered_kernels_are_exported_and_tested() -> None:
    assert set(EACH_LEAF) == set(LEAVES)
    assert {*LEAVES, *COMPOSITIONS} == text_file.KERNELS


def test_it_acts_like_the_policy_for_all_kernels_and_inputs(program: Path, tmp_path: Path) -> None:
    policies = [small_policy(kernel, inputs, repeat) for kernel in KERNELS for inputs in INPUTS for repeat in (1, 3)]
    policies += [small_policy("rbf", "window", centres=0), small_policy("sum", "angles", 2, scalar=True)]
    files = [tmp_path / f"{number}.txt" for number in range(len(policies))]
    for file, policy in zip(files, policies, strict=True):
        file.write_text(policy_text(policy))
    done = run(program, *files)
    assert done.returncode == 0, done.stdout
    for policy, line in zip(policies, done.stdout.splitlines(), strict=True):
        expected = acted(policy, random_episode())
        got = np.array(line.split(), dtype=float).reshape(2, *expected.shape)
        assert np.allclose(got, expected, rtol=1e-9, atol=1e-9), policy.gaussian
    assert len(expected) == STEPS


def test_a_file_that_is_missing_damaged_or_of_another_version_is_rejected(program: Path, tmp_path: Path) -> None:
    text, angles, monomials = (policy_text(small_policy("rbf", inputs)) for inputs in ("plain", "angles", "monomials"))
    file = tmp_path / "policy.txt"
    for content, reason in {
        None: "whole policy file",
        text[:-40]: "whole policy file",
        text.replace(FIRST_LINE, "rkhs_policy 2"): "'rkhs_policy 1'",
        text.replace("rbf", "laplace"): "unknown kernel laplace",
        text.replace("\n4 1 1\n", "\n7 1 1\n"): "the sizes do not match",
        text.replace("\n4 1 1\n", "\n4 0 1\n"): "the sizes do not match",
        text.replace("\n4 1 1\n", "\n4 -1 1\n"): "expected a whole number below",
        text.replace("\n4 1 1\n", "\n4 1.5 1\n"): "expected a whole number below",
        text.replace("rbf", "sum"): "the sizes do not match",
        text.replace("rbf 4 ", "rbf 99999999 "): "whole policy file",
        angles.replace("\n2 2.0 0.0\n", "\n2 9.0 0.0\n"): "expected a whole number below 4",
        angles.replace("\n2 360.0 1.0\n", "\n1 360.0\n"): "the sizes do not match",
        monomials.replace("\n30 0.0", "\n30 5.0"): "expected a whole number below 5",
    }.items():
        if content is not None:
            file.write_text(content)
        done = run(program, file)
        assert done.returncode == 1
        assert reason in done.stdout


def test_an_observation_that_is_not_finite_is_rejected(program: Path, tmp_path: Path) -> None:
    file = tmp_path / "policy.txt"
    file.write_text(policy_text(small_policy("rbf", "plain")))
    done = subprocess.run([program, file], input="0 0 1e300 0", capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "observation: expected finite numbers\n")


def test_the_header_stays_small() -> None:
    assert len(HEADER.read_text().splitlines()) <= LINES
