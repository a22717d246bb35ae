#include "tests/golden/golden_file.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>

namespace rips::golden {
namespace {

constexpr char kMark[] = "#= ";

GoldenFile Load(const std::filesystem::path& path) {
  GoldenFile out;
  out.path = path.string();
  std::ifstream in(path, std::ios::binary);
  const std::string text(std::istreambuf_iterator<char>(in), {});
  const size_t mark = text.find(std::string("\n") + kMark);
  const size_t end = mark == std::string::npos ? text.size() : mark + 1;
  out.input = text.substr(0, end);
  out.expected = text.substr(end);
  return out;
}

}  // namespace

std::vector<GoldenFile> LoadGoldenFiles() {
  std::vector<GoldenFile> out;
  for (const auto& entry : std::filesystem::directory_iterator(RIPS_SOURCE_DIR "/tests/golden")) {
    if (entry.path().extension() == ".rul") out.push_back(Load(entry.path()));
  }
  std::sort(out.begin(), out.end(),
            [](const GoldenFile& a, const GoldenFile& b) { return a.path < b.path; });
  return out;
}

}  // namespace rips::golden
