// Verification of an audit log as `ripsctl audit verify` does it, from files: records of the size
// of a decision, sealed in groups of 50, in segments of 64 MiB.
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "benchmark/benchmark.h"
#include "policy_server/audit/format.h"
#include "policy_server/audit/segments.h"
#include "policy_server/audit/signing_key.h"
#include "policy_server/audit/verify.h"
#include "services/base/check.h"

namespace rips::bench {
namespace {

constexpr size_t kPayloadBytes = 400;
constexpr uint64_t kGroup = 50;
constexpr size_t kSegmentBytes = size_t{64} << 20;

// A directory that goes when this goes.
struct TempDirectory {
  TempDirectory() { RIPS_CHECK(mkdtemp(path.data()) != nullptr, path.c_str()); }
  ~TempDirectory() { std::filesystem::remove_all(path); }
  std::string path = (std::filesystem::temp_directory_path() / "rips-audit-XXXXXX").string();
};

class LogWriter {
 public:
  explicit LogWriter(const std::string& directory) : directory_(directory) { Begin(); }

  void Write(uint64_t records) {
    for (uint64_t i = 1; i <= records; ++i) {
      Add({.sequence = ++sequence_,
           .previous_hash = hash_,
           .payload = absl::StrCat(sequence_, std::string(kPayloadBytes, 'r'))});
      head_ = hash_;
      if (i % kGroup != 0 && i != records) continue;
      Seal();
      if (i != records && file_.size() >= kSegmentBytes) Begin();
    }
    Save();
  }

 private:
  void Begin() {
    if (number_ > 0) Save();
    const auto key = std::make_shared<const audit::SigningKey>(*audit::SigningKey::Generate());
    audit::SegmentHeader header{.number = ++number_,
                                .first_sequence = sequence_ + 1,
                                .time_unix_ns = 1,
                                .previous_bytes = file_.size(),
                                .previous_hash = hash_,
                                .public_key = key->public_key()};
    const audit::SigningKey& signer = key_ == nullptr ? *key : *key_;
    header.signature = *signer.Sign(audit::HeaderToSign(header));
    key_ = key;
    file_ = audit::EncodeHeader(header);
    hash_ = audit::Sha256(file_);
  }
  void Add(audit::Piece piece) {
    file_ += audit::EncodePiece(piece);
    hash_ = piece.hash;
  }
  void Seal() {
    Add({.kind = audit::Piece::Kind::kSeal,
         .sequence = sequence_,
         .previous_hash = hash_,
         .payload = *key_->Sign(audit::SealToSign(number_, sequence_, head_))});
  }
  void Save() const {
    std::ofstream(absl::StrCat(directory_, "/", audit::SegmentName(number_)), std::ios::binary)
        << file_;
  }

  const std::string directory_;
  std::string file_;
  std::string hash_ = std::string(audit::kHashBytes, '\0');
  std::string head_;
  uint64_t number_ = 0;
  uint64_t sequence_ = 0;
  std::shared_ptr<const audit::SigningKey> key_;
};

void VerifyLog(benchmark::State& state) {
  const auto records = static_cast<uint64_t>(state.range(0));
  const TempDirectory directory;
  LogWriter(directory.path).Write(records);
  const audit::SegmentsInDirectory segments(directory.path);
  for (auto _ : state) {
    const auto report = audit::Verify(segments);
    if (!report.ok() || report->fault || report->records != records) {
      state.SkipWithError("the log is not whole");
      return;
    }
  }
  state.SetItemsProcessed(static_cast<int64_t>(records) * state.iterations());
}
BENCHMARK(VerifyLog)->Name("Audit/verify")->Arg(1'000'000)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rips::bench
