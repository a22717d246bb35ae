#include "policy_server/policy/inspect/yara_speed.h"

#include <time.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/inspect/yara_scanner.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

constexpr size_t kFirstTrialBytes = 256;
constexpr int kScansOfATrial = 3;
// An interruption does not cost so much.
const absl::Duration kNoInterruption = 4 * kTrialCpuMax;
// libyara looks for pieces of at most this size (YR_MAX_ATOM_LENGTH) before it tries a pattern.
constexpr size_t kPieceBytes = 4;
// Looked at of one { 41 42 }: bounds the work for a file of braces.
constexpr size_t kHexStringBytesMax = 4096;
constexpr size_t kPieceTrialBytes = 1024;
// A piece that costs this much on kPieceTrialBytes is tried on kTrialBytes too.
constexpr absl::Duration kPieceSuspicious = absl::Milliseconds(1);
// Places of a file that pieces are taken from, and pieces tried, both spread evenly.
constexpr size_t kPositionsMax = size_t{64} << 10;
constexpr size_t kPiecesMax = 1024;
// After this much CPU time the rest of the pieces is not tried: a large file is not slow for that.
constexpr absl::Duration kPiecesCpuMax = absl::Milliseconds(500);

absl::Duration ThreadCpu() {
  timespec now = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return absl::DurationFromTimespec(now);
}

class Trials {
 public:
  explicit Trials(const YaraRules& rules) : scanner_(rules), started_(ThreadCpu()) {}

  absl::StatusOr<absl::Duration> Run(absl::string_view bytes, absl::string_view what) {
    engine::Verdict verdict = engine::Verdict::kUnscanned;
    absl::Duration took = absl::InfiniteDuration();
    // A scan that was interrupted costs somewhat more than it needs; a slow one does so each time.
    for (int i = 0; i < kScansOfATrial && took > kTrialCpuMax; ++i) {
      const absl::Duration before = ThreadCpu();
      verdict = scanner_.Scan(bytes, absl::Seconds(1));
      took = std::min(took, ThreadCpu() - before);
      if (verdict == engine::Verdict::kUnscanned || took > kNoInterruption) break;
    }
    if (took > kTrialCpuMax) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "slow: ", bytes.size(), " bytes of ", what, " take ", absl::ToInt64Milliseconds(took),
          " ms to scan, limit ", absl::ToInt64Milliseconds(kTrialCpuMax),
          " ms; anchor or shorten its patterns"));
    }
    if (verdict == engine::Verdict::kUnscanned) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "slow: cannot scan ", bytes.size(), " bytes of ", what, ": ", scanner_.failure()));
    }
    if (ThreadCpu() - started_ > kTrialsCpuMax) {  // a file of many patterns, each not slow
      return absl::ResourceExhaustedError(absl::StrCat("slow: trial scans take more than ",
                                                       absl::ToInt64Seconds(kTrialsCpuMax), " s"));
    }
    return took;
  }

  absl::Status RunPiece(absl::string_view piece) {
    const std::string what = absl::StrCat("`", absl::CHexEscape(piece), "`");
    RIPS_ASSIGN_OR_RETURN(const absl::Duration took, Run(Repeat(piece, kPieceTrialBytes), what));
    if (took < kPieceSuspicious) return absl::OkStatus();
    return Run(Repeat(piece, kTrialBytes), what).status();
  }

 private:
  static std::string Repeat(absl::string_view piece, size_t size) {
    std::string bytes;
    while (bytes.size() < size) absl::StrAppend(&bytes, piece);
    return bytes;
  }

  YaraScanner scanner_;
  const absl::Duration started_;
};

// The same on every machine and run.
std::string PseudoRandom(size_t size) {
  std::string bytes(size, '\0');
  uint32_t state = 1;
  for (char& byte : bytes) {
    state = state * 1664525 + 1013904223;
    byte = static_cast<char>(state >> 24);
  }
  return bytes;
}

// What stands in `text` as hexadecimal digits, such as { 41 42 }, as bytes.
std::string HexBytes(absl::string_view text) {
  std::string digits;
  for (const char c : text) {
    if (absl::ascii_isxdigit(c)) digits.push_back(c);
  }
  if (digits.size() % 2 == 1) digits.pop_back();
  return absl::HexStringToBytes(digits);
}

using Piece = std::array<char, kPieceBytes>;

void AddPieces(absl::string_view text, std::vector<Piece>& pieces) {
  const size_t step = text.size() / kPositionsMax + 1;
  for (size_t at = 0; at + kPieceBytes <= text.size(); at += step) {
    Piece& piece = pieces.emplace_back();
    std::copy_n(text.begin() + at, kPieceBytes, piece.begin());
  }
}

// Distinct, in the order of their bytes, at most kPiecesMax.
std::vector<Piece> Pieces(absl::string_view text) {
  std::vector<Piece> all;
  AddPieces(text, all);
  for (size_t close = text.find('}'); close != absl::string_view::npos;
       close = text.find('}', close + 1)) {
    // The innermost braces.
    const size_t open = text.rfind('{', close);
    if (open == absl::string_view::npos) continue;
    AddPieces(HexBytes(text.substr(open, std::min(close - open, kHexStringBytesMax))), all);
  }
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  if (all.size() <= kPiecesMax) return all;
  std::vector<Piece> some;
  for (size_t i = 0; i < kPiecesMax; ++i) some.push_back(all[i * all.size() / kPiecesMax]);
  return some;
}

absl::Status RunPlain(Trials& trials, size_t size) {
  RIPS_RETURN_IF_ERROR(trials.Run(PseudoRandom(size), "random data").status());
  for (int value = 0; value < 256; ++value) {
    const std::string run(size, static_cast<char>(value));
    RIPS_RETURN_IF_ERROR(
        trials.Run(run, absl::StrCat("0x", absl::Hex(value, absl::kZeroPad2))).status());
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckSpeed(const YaraRules& rules, absl::string_view text) {
  Trials trials(rules);
  for (size_t size = kFirstTrialBytes; size <= kTrialBytes; size *= 4) {
    RIPS_RETURN_IF_ERROR(RunPlain(trials, size));
  }
  const absl::Duration end = ThreadCpu() + kPiecesCpuMax;
  for (const Piece& piece : Pieces(text)) {
    if (ThreadCpu() > end) break;
    RIPS_RETURN_IF_ERROR(trials.RunPiece({piece.data(), piece.size()}));
  }
  return absl::OkStatus();
}

}  // namespace rips::inspect
