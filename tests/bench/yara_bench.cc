// Scanning payloads: the same rules and files as the `yara` program gets from tests/bench/run,
// which names them in the environment. Without them there is nothing to scan.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>

#include "policy_server/inspect/yara_scanner.h"
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

void Yara(benchmark::State& state, const char* kind) {
  const char* inputs = std::getenv("RIPS_BENCH_YARA");
  if (inputs == nullptr) {
    state.SkipWithError("needs tests/bench/run");
    return;
  }
  const std::filesystem::path directory(inputs);
  auto rules = inspect::YaraRules::Create(ReadAll(directory / "rules.yar"), "rules.yar");
  const std::vector<std::string> payloads = Payloads(directory / kind);
  if (!rules.ok() || payloads.empty()) {
    state.SkipWithError("no rules or no payloads");
    return;
  }
  inspect::YaraScanner scanner(**rules);
  if (scanner.Scan("xx RIPS-BENCH-MARK xx", absl::Seconds(10)) != engine::Verdict::kYes) {
    state.SkipWithError("the rules do not work");
  }
  size_t at = 0;
  size_t bytes = 0;
  for (auto _ : state) {
    if (scanner.Scan(payloads[at], absl::Seconds(10)) != engine::Verdict::kNo) {
      state.SkipWithError("a clean payload was not found clean");
      break;
    }
    bytes += payloads[at].size();
    at = (at + 1) % payloads.size();
  }
  state.SetBytesProcessed(static_cast<int64_t>(bytes));
}
BENCHMARK_CAPTURE(Yara, random, "random")->Name("yara/random");
BENCHMARK_CAPTURE(Yara, floats, "floats")->Name("yara/floats");
BENCHMARK_CAPTURE(Yara, text, "text")->Name("yara/text");

}  // namespace
}  // namespace rips::bench
