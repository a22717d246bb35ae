// One operator's watch: a stream of T until either side ends it.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_WATCH_STREAM_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_WATCH_STREAM_H_

#include <functional>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "grpcpp/support/server_callback.h"
#include "services/rpc/status_conversion.h"
#include "services/rpc/stream_outbound.h"

namespace rips::operator_api {

// Owned by gRPC until OnDone, which deletes it.
template <typename T>
class WatchStream final : public grpc::ServerWriteReactor<T> {
 public:
  using Outbound = rpc::StreamOutbound<grpc::ServerWriteReactor<T>, T>;

  WatchStream() : outbound_(std::make_shared<Outbound>(this)) {}
  const std::shared_ptr<Outbound>& outbound() const { return outbound_; }
  // Dropped when the stream is over. Set before the handler returns.
  void set_session(std::shared_ptr<void> session) { session_ = std::move(session); }
  // Called once, when the stream is over. Set before the handler returns.
  void set_on_ended(std::function<void()> on_ended) { on_ended_ = std::move(on_ended); }
  // Called whenever everything that waited has been written. Set before the handler returns.
  void set_on_drained(std::function<void()> on_drained) { on_drained_ = std::move(on_drained); }

 private:
  void OnWriteDone(bool ok) override {
    outbound_->OnWritten(ok);
    if (ok && on_drained_ && outbound_->waiting() == 0) on_drained_();
  }
  void OnCancel() override { outbound_->Close(grpc::Status::CANCELLED); }
  void OnDone() override {
    outbound_->Detach();
    if (on_ended_) on_ended_();
    delete this;
  }

  std::shared_ptr<Outbound> outbound_;
  std::function<void()> on_ended_;
  std::function<void()> on_drained_;
  std::shared_ptr<void> session_;
};

// A stream that ends at once.
template <typename T>
grpc::ServerWriteReactor<T>* RefuseWatch(const absl::Status& status) {
  auto* stream = new WatchStream<T>();
  stream->outbound()->Close(rpc::ToGrpc(status));
  return stream;
}

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_WATCH_STREAM_H_
