// simulate --seed N --steps M [--fault NAME]: worlds of the seeds from N on. An invariant that is
// violated is shown with the events before it. Exit status 1: one was violated.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_join.h"
#include "absl/strings/string_view.h"
#include "tests/simulation/world.h"

namespace rips::simulation {
namespace {

unsigned long long Shown(uint64_t number) { return number; }

struct Arguments {
  uint64_t seed = 1;
  uint64_t steps = 100'000;
  uint64_t steps_each = 5'000;
  Fault fault = Fault::kNone;
};

std::optional<Arguments> Parse(int argc, char** argv) {
  Arguments arguments;
  for (int i = 1; i < argc; i += 2) {
    const absl::string_view name = argv[i];
    const absl::string_view value = i + 1 < argc ? argv[i + 1] : "";
    bool good = false;
    if (name == "--seed") good = absl::SimpleAtoi(value, &arguments.seed);
    if (name == "--steps") good = absl::SimpleAtoi(value, &arguments.steps);
    if (name == "--steps-each") good = absl::SimpleAtoi(value, &arguments.steps_each);
    for (size_t f = 0; name == "--fault" && f < kFaultNames.size(); ++f) {
      if (value != kFaultNames[f]) continue;
      arguments.fault = static_cast<Fault>(f);
      good = true;
    }
    if (!good || arguments.steps_each == 0) return std::nullopt;
  }
  return arguments;
}

int Main(int argc, char** argv) {
  const std::optional<Arguments> arguments = Parse(argc, argv);
  if (!arguments.has_value()) {
    std::fprintf(stderr,
                 "usage: simulate [--seed N] [--steps M] [--steps-each M] [--fault NAME]\n"
                 "  worlds of --steps-each steps, of the seeds from N on, M steps in all\n"
                 "  faults: %s\n",
                 absl::StrJoin(kFaultNames, ", ").c_str());
    return 2;
  }
  Counts counts;
  const std::optional<Finding> found =
      Search(arguments->seed, arguments->steps, arguments->steps_each, arguments->fault, &counts);
  if (!found.has_value()) {
    std::printf("no violation in %llu steps from seed %llu\n", Shown(arguments->steps),
                Shown(arguments->seed));
    std::printf(
        "%llu decisions, %llu lowerings by rules and %llu by operators, %llu observations judged, "
        "%llu sent again, %llu levels verified, %llu floors raised and %llu lifted, %llu stale "
        "commands refused\n",
        Shown(counts.decisions), Shown(counts.soft_lowerings), Shown(counts.operator_lowerings),
        Shown(counts.judged), Shown(counts.resent), Shown(counts.verified), Shown(counts.floors),
        Shown(counts.lifted), Shown(counts.refused_stale));
    return 0;
  }
  std::printf("seed %llu, step %llu (%llu in all): %s violated: %s\n", Shown(found->seed),
              Shown(found->step), Shown(found->total), found->violation.invariant.c_str(),
              found->violation.what.c_str());
  for (const std::string& line : found->trace) std::printf("  %s\n", line.c_str());
  return 1;
}

}  // namespace
}  // namespace rips::simulation

int main(int argc, char** argv) { return rips::simulation::Main(argc, argv); }
