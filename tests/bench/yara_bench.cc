// Scanning payloads: the same rules and files as the `yara` program gets from tests/bench/run,
// which names them in the environment. Without them there is nothing to scan.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>

#include "policy_server/policy/inspect/scanner_process.h"
#include "policy_server/policy/inspect/yara_scanner.h"
#include "services/runtime/real_clock.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

std::string ReadAll(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(in), {});
}

std::vector<std::string> Payloads(const std::string& directory) {
  std::vector<std::string> payloads;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(directory, error)) {
    payloads.push_back(ReadAll(entry.path()));
  }
  std::sort(payloads.begin(), payloads.end());
  return payloads;
}

// What one run scans with, and the payloads.
struct Inputs {
  std::shared_ptr<const inspect::YaraRules> rules;
  std::vector<std::string> payloads;
};

// No rules: the run is skipped, which says why.
Inputs Prepare(benchmark::State& state, const char* kind) {
  const char* inputs = std::getenv("RIPS_BENCH_YARA");
  if (inputs == nullptr) {
    state.SkipWithError("needs tests/bench/run");
    return {};
  }
  const std::filesystem::path directory(inputs);
  auto rules = inspect::YaraRules::Create(ReadAll(directory / "rules.yar"), "rules.yar");
  std::vector<std::string> payloads = Payloads(directory / kind);
  if (!rules.ok() || payloads.empty()) {
    state.SkipWithError("no rules or no payloads");
    return {};
  }
  return {*std::move(rules), std::move(payloads)};
}

template <typename Scan>
void Measure(benchmark::State& state, const std::vector<std::string>& payloads, const Scan& scan) {
  if (scan("xx RIPS-BENCH-MARK xx") != engine::Verdict::kYes) {
    state.SkipWithError("the rules do not work");
  }
  size_t at = 0;
  size_t bytes = 0;
  for (auto _ : state) {
    if (scan(payloads[at]) != engine::Verdict::kNo) {
      state.SkipWithError("a clean payload was not found clean");
      break;
    }
    bytes += payloads[at].size();
    at = (at + 1) % payloads.size();
  }
  state.SetBytesProcessed(static_cast<int64_t>(bytes));
}

void Yara(benchmark::State& state, const char* kind) {
  const Inputs inputs = Prepare(state, kind);
  if (inputs.rules == nullptr) return;
  inspect::YaraScanner scanner(*inputs.rules);
  Measure(state, inputs.payloads,
          [&](absl::string_view bytes) { return scanner.Scan(bytes, absl::Seconds(10)); });
}
BENCHMARK_CAPTURE(Yara, random, "random")->Name("yara/random");
BENCHMARK_CAPTURE(Yara, floats, "floats")->Name("yara/floats");
BENCHMARK_CAPTURE(Yara, text, "text")->Name("yara/text");

// The same in rips-scan, as the server does it. Its time is another process's, so both are measured
// in real time.
void YaraProcess(benchmark::State& state, const char* kind) {
  const Inputs inputs = Prepare(state, kind);
  if (inputs.rules == nullptr) return;
  const RealClock clock;
  const auto own = std::filesystem::read_symlink("/proc/self/exe");
  const std::string helpers = (own.parent_path() / "../bin").string();
  auto image = inspect::RuleImage::Create({inputs.rules});
  if (!image.ok()) return state.SkipWithError("no image");
  inspect::ScannerProcess scanner(*image,
                                  {.payload_bytes_max = size_t{4} << 20,
                                   .scan_time = absl::Seconds(10),
                                   .contain = {.helpers = helpers}},
                                  &clock);
  Measure(state, inputs.payloads,
          [&](absl::string_view bytes) { return scanner.Scan(0, "robot", bytes); });
}
BENCHMARK_CAPTURE(Yara, text, "text")->Name("scan_here/text")->UseRealTime();
BENCHMARK_CAPTURE(YaraProcess, text, "text")->Name("scan_apart/text")->UseRealTime();
BENCHMARK_CAPTURE(Yara, frames, "frames")->Name("scan_here/frames")->UseRealTime();
BENCHMARK_CAPTURE(YaraProcess, frames, "frames")->Name("scan_apart/frames")->UseRealTime();
BENCHMARK_CAPTURE(Yara, small, "small")->Name("scan_here/small")->UseRealTime();
BENCHMARK_CAPTURE(YaraProcess, small, "small")->Name("scan_apart/small")->UseRealTime();

}  // namespace
}  // namespace rips::bench
