#include "policy_server/policy/recording/decompress.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <memory>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

// Room beyond what was announced: only there can a decoder show that there is more.
constexpr size_t kSpareBytes = 1;
constexpr size_t kFirstBytes = 64 * 1024;
// 2^28 = 256 MiB.
constexpr int kZstdWindowLogMax = 28;

// The output grows with what comes out, so that an announced size alone costs nothing.
class Output {
 public:
  Output(size_t size, std::string* out) : limit_(size + kSpareBytes), out_(*out) { out_.clear(); }
  ~Output() { out_.resize(std::min(used_, limit_ - kSpareBytes)); }
  Output(const Output&) = delete;
  Output& operator=(const Output&) = delete;

  // Where the decoder may write; at least one byte.
  char* free() { return out_.data() + used_; }
  size_t free_bytes() const { return out_.size() - used_; }
  // False if more came out than was announced.
  bool Grow() {
    if (used_ >= limit_) return false;
    if (used_ == out_.size()) {
      out_.resize(std::min(limit_, std::max(kFirstBytes, out_.size() * 2)));
    }
    return true;
  }
  void Take(size_t bytes) { used_ += bytes; }

  absl::Status Finish() const {
    const size_t announced = limit_ - kSpareBytes;
    if (used_ == announced) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat(used_ > announced ? "more" : "less", " than the ",
                                            announced, " bytes it announces come out"));
  }

 private:
  const size_t limit_;
  std::string& out_;
  size_t used_ = 0;
};

absl::Status DecompressZstd(absl::string_view bytes, Output& out) {
  const std::unique_ptr<ZSTD_DCtx, size_t (*)(ZSTD_DCtx*)> decoder(ZSTD_createDCtx(),
                                                                   ZSTD_freeDCtx);
  if (decoder == nullptr) return absl::ResourceExhaustedError("zstd: out of memory");
  ZSTD_DCtx_setParameter(decoder.get(), ZSTD_d_windowLogMax, kZstdWindowLogMax);
  ZSTD_inBuffer input = {bytes.data(), bytes.size(), 0};
  while (out.Grow()) {
    ZSTD_outBuffer output = {out.free(), out.free_bytes(), 0};
    const size_t before = input.pos;
    // 0 = between two frames.
    const size_t left = ZSTD_decompressStream(decoder.get(), &output, &input);
    if (ZSTD_isError(left)) {
      return absl::DataLossError(absl::StrCat("zstd: ", ZSTD_getErrorName(left)));
    }
    out.Take(output.pos);
    if (left == 0 && input.pos == input.size) return absl::OkStatus();
    if (output.pos == 0 && input.pos == before) {
      return absl::DataLossError("zstd: the content is cut");
    }
  }
  return absl::OkStatus();
}

absl::Status DecompressLz4(absl::string_view bytes, Output& out) {
  LZ4F_dctx* raw = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&raw, LZ4F_VERSION))) {
    return absl::ResourceExhaustedError("lz4: out of memory");
  }
  const std::unique_ptr<LZ4F_dctx, size_t (*)(LZ4F_dctx*)> decoder(raw,
                                                                   LZ4F_freeDecompressionContext);
  size_t at = 0;
  while (out.Grow()) {
    size_t produced = out.free_bytes();
    size_t consumed = bytes.size() - at;
    const size_t left = LZ4F_decompress(decoder.get(), out.free(), &produced, bytes.data() + at,
                                        &consumed, nullptr);
    if (LZ4F_isError(left)) {
      return absl::DataLossError(absl::StrCat("lz4: ", LZ4F_getErrorName(left)));
    }
    out.Take(produced);
    at += consumed;
    if (left == 0 && at == bytes.size()) return absl::OkStatus();
    if (produced == 0 && consumed == 0) return absl::DataLossError("lz4: the content is cut");
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status Decompress(absl::string_view format, absl::string_view bytes, size_t size,
                        std::string* out) {
  if (format.empty()) {
    out->assign(bytes.data(), std::min(bytes.size(), size));
    if (bytes.size() == size) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat(bytes.size(), " bytes, ", size, " announced"));
  }
  Output output(size, out);
  if (format == "zstd") {
    RIPS_RETURN_IF_ERROR(DecompressZstd(bytes, output));
  } else if (format == "lz4") {
    RIPS_RETURN_IF_ERROR(DecompressLz4(bytes, output));
  } else {
    return absl::InvalidArgumentError("unknown compression; known are lz4 and zstd");
  }
  return output.Finish();
}

}  // namespace rips::recording
