// One operator's watch: a stream of T until either side ends it.
#ifndef RIPS_POLICY_SERVER_OPERATOR_API_WATCH_STREAM_H_
#define RIPS_POLICY_SERVER_OPERATOR_API_WATCH_STREAM_H_

#include <memory>

#include "grpcpp/support/server_callback.h"
#include "services/rpc/stream_outbound.h"

namespace rips::operator_api {

// Owned by gRPC until OnDone, which deletes it.
template <typename T>
class WatchStream final : public grpc::ServerWriteReactor<T> {
 public:
  using Outbound = rpc::StreamOutbound<grpc::ServerWriteReactor<T>, T>;

  WatchStream() : outbound_(std::make_shared<Outbound>(this)) {}
  const std::shared_ptr<Outbound>& outbound() const { return outbound_; }

 private:
  void OnWriteDone(bool ok) override { outbound_->OnWritten(ok); }
  void OnCancel() override { outbound_->Close(grpc::Status::CANCELLED); }
  void OnDone() override {
    outbound_->Detach();
    delete this;
  }

  std::shared_ptr<Outbound> outbound_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_OPERATOR_API_WATCH_STREAM_H_
