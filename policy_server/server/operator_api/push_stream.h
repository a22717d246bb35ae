// A bundle on its way from an operator: collects the pieces of the archive.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_PUSH_STREAM_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_PUSH_STREAM_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "grpcpp/support/server_callback.h"
#include "rips/v1/operator.pb.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

// Owned by gRPC until OnDone, which deletes it.
class PushStream final : public grpc::ServerReadReactor<rips::v1::PushBundleRequest> {
 public:
  // From the first piece on a push may take kPatience, and a second for each kBytesPerSecond that
  // have come: beyond, the stream is ended, so that it does not keep others from pushing.
  static constexpr absl::Duration kPatience = absl::Seconds(15);
  static constexpr size_t kBytesPerSecond = size_t{64} << 10;

  // Answers the call once, on any thread; after the stream is over it does nothing.
  class Answer {
   public:
    explicit Answer(PushStream* stream) : stream_(stream) {}
    void End(const absl::Status& status) ABSL_LOCKS_EXCLUDED(mu_);
    // The stream is over.
    void Detach() ABSL_LOCKS_EXCLUDED(mu_);
    // Fills in the response if the stream is not over.
    void Fill(const rips::v1::PushBundleResponse& response) ABSL_LOCKS_EXCLUDED(mu_);
    // The call has been answered, or the stream is over.
    bool ended() ABSL_LOCKS_EXCLUDED(mu_);
    // Dropped before the call is answered, so that a client that has the answer may push again,
    // unless it is taken: then the taker drops it.
    void set_turn(std::shared_ptr<void> turn) ABSL_LOCKS_EXCLUDED(mu_);
    std::shared_ptr<void> TakeTurn() ABSL_LOCKS_EXCLUDED(mu_);

   private:
    Mutex mu_;
    PushStream* stream_ ABSL_GUARDED_BY(mu_);
    bool ended_ ABSL_GUARDED_BY(mu_) = false;
    std::shared_ptr<void> turn_ ABSL_GUARDED_BY(mu_);
  };
  // Called once with the whole archive, on a thread of gRPC; must not block.
  using Whole = std::function<void(std::string archive, const std::shared_ptr<Answer>& answer)>;
  // Called with each piece; not OK ends the stream.
  using Heard = std::function<absl::Status(const rips::v1::PushBundleRequest& piece)>;

  PushStream(const Clock* clock, rips::v1::PushBundleResponse* response, Heard heard, Whole whole);
  // Reads. Once, before the handler returns; what it holds is set by then.
  void Begin() { StartRead(&piece_); }
  const std::shared_ptr<Answer>& answer() const { return answer_; }
  // Dropped when the stream is over. Set before Begin.
  void set_held(std::shared_ptr<void> held) { held_ = std::move(held); }

 private:
  void OnReadDone(bool ok) override;
  void OnCancel() override { answer_->End(absl::CancelledError("the push was cancelled")); }
  void OnDone() override;
  // Adds the piece that was read.
  absl::Status Take();

  const Clock* clock_;
  const int64_t began_ns_;
  rips::v1::PushBundleResponse* const response_;
  const Heard heard_;
  const Whole whole_;
  const std::shared_ptr<Answer> answer_;
  rips::v1::PushBundleRequest piece_;
  std::string archive_;
  uint64_t archive_bytes_ = 0;
  std::shared_ptr<void> held_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_PUSH_STREAM_H_
