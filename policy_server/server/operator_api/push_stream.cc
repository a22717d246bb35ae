#include "policy_server/server/operator_api/push_stream.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "services/rpc/status_conversion.h"

namespace rips::operator_api {

void PushStream::Answer::End(const absl::Status& status) {
  PushStream* stream = nullptr;
  std::shared_ptr<void> turn;
  {
    MutexLock lock(&mu_);
    if (stream_ == nullptr || ended_) return;
    ended_ = true;
    stream = stream_;
    turn = std::move(turn_);
  }
  turn.reset();
  // It is not over before this.
  stream->Finish(rpc::ToGrpc(status));
}

void PushStream::Answer::Detach() {
  MutexLock lock(&mu_);
  stream_ = nullptr;
}

void PushStream::Answer::Fill(const rips::v1::PushBundleResponse& response) {
  MutexLock lock(&mu_);
  if (stream_ != nullptr && !ended_) *stream_->response_ = response;
}

bool PushStream::Answer::ended() {
  MutexLock lock(&mu_);
  return stream_ == nullptr || ended_;
}

void PushStream::Answer::set_turn(std::shared_ptr<void> turn) {
  MutexLock lock(&mu_);
  turn_ = std::move(turn);
}

std::shared_ptr<void> PushStream::Answer::TakeTurn() {
  MutexLock lock(&mu_);
  return std::move(turn_);
}

PushStream::PushStream(const Clock* clock, rips::v1::PushBundleResponse* response, Heard heard,
                       Whole whole)
    : clock_(clock),
      began_ns_(clock->Now().boottime_ns),
      response_(response),
      heard_(std::move(heard)),
      whole_(std::move(whole)),
      answer_(std::make_shared<Answer>(this)) {}

void PushStream::OnReadDone(bool ok) {
  // Another thread may have ended it meanwhile; what is whole then is not wanted any more.
  if (answer_->ended()) return;
  if (ok) {
    const absl::Status taken = Take();
    if (!taken.ok()) return answer_->End(taken);
    return StartRead(&piece_);
  }
  if (archive_.empty() || archive_.size() != archive_bytes_) {
    return answer_->End(absl::InvalidArgumentError(
        absl::StrCat("the push ended after ", archive_.size(), " of ", archive_bytes_, " bytes")));
  }
  whole_(std::move(archive_), answer_);
}

absl::Status PushStream::Take() {
  if (absl::Status heard = heard_(piece_); !heard.ok()) return heard;
  const absl::Duration allowed =
      kPatience + absl::Seconds(static_cast<int64_t>(archive_.size() / kBytesPerSecond));
  if (absl::Nanoseconds(clock_->Now().boottime_ns - began_ns_) > allowed) {
    return absl::DeadlineExceededError(
        absl::StrCat("the push is too slow: less than ", kBytesPerSecond, " bytes a second"));
  }
  if (piece_.archive_bytes() == 0 || piece_.archive_bytes() > bundle::kArchiveBytesMax) {
    return absl::InvalidArgumentError(absl::StrCat(
        "a bundle of ", piece_.archive_bytes(), " bytes; the limit is ", bundle::kArchiveBytesMax));
  }
  if (archive_bytes_ == 0) archive_bytes_ = piece_.archive_bytes();
  if (piece_.data().empty() || piece_.archive_bytes() != archive_bytes_ ||
      piece_.data().size() > archive_bytes_ - archive_.size()) {
    return absl::InvalidArgumentError("the pieces of the push do not fit together");
  }
  archive_.append(piece_.data());
  return absl::OkStatus();
}

void PushStream::OnDone() {
  answer_->Detach();
  delete this;
}

}  // namespace rips::operator_api
