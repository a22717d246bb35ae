// The server's end of one bidirectional stream, over gRPC's callback API.
#ifndef RIPS_SERVICES_RPC_SERVER_STREAM_H_
#define RIPS_SERVICES_RPC_SERVER_STREAM_H_

#include <memory>

#include "google/protobuf/arena.h"
#include "grpcpp/support/server_callback.h"
#include "services/rpc/stream_outbound.h"

namespace rips::rpc {

// Owned by gRPC from the handler's return until OnDone, which deletes it. Derived classes call
// Begin() last in their constructor.
template <typename In, typename Out>
class ServerStream : public grpc::ServerBidiReactor<In, Out> {
 public:
  // What others hold of the stream: outlives it.
  using Outbound = StreamOutbound<grpc::ServerBidiReactor<In, Out>, Out>;
  const std::shared_ptr<Outbound>& outbound() const { return outbound_; }

 protected:
  ServerStream() : outbound_(std::make_shared<Outbound>(this)) {}
  void Begin() { this->StartRead(incoming_); }

  // One message, which lives until this returns; its texts may be taken. Reactions of one stream's
  // reads never overlap.
  virtual void OnMessage(In& message) = 0;
  // The stream ends because a message of the peer could not be decoded, or because the peer
  // half-closed it, which no agent does. Before OnEnded.
  virtual void OnUnreadable() {}
  // The stream is over; nothing is called afterwards.
  virtual void OnEnded() = 0;

 private:
  void OnReadDone(bool ok) final {
    if (!ok) {
      arena_.Reset();  // a message that could not be decoded may be large
      unreadable_ = outbound_->open();
      return outbound_->Close(grpc::Status(
          grpc::StatusCode::INVALID_ARGUMENT,
          "a message cannot be decoded (is a text not UTF-8?), or the stream was half-closed"));
    }
    // Its read was under way when the stream was ended.
    if (outbound_->ended()) return;
    OnMessage(*incoming_);
    arena_.Reset();
    incoming_ = google::protobuf::Arena::CreateMessage<In>(&arena_);
    this->StartRead(incoming_);
  }
  void OnWriteDone(bool ok) final { outbound_->OnWritten(ok); }
  void OnCancel() final {
    cancelled_ = true;
    outbound_->Close(grpc::Status::CANCELLED);
  }
  void OnDone() final {
    outbound_->Detach();
    // A connection that breaks fails the read too; gRPC then calls OnCancel as well.
    if (unreadable_ && !cancelled_) OnUnreadable();
    OnEnded();
    delete this;
  }

  std::shared_ptr<Outbound> outbound_;
  // Of one message. The parts of a batch are hundreds.
  google::protobuf::Arena arena_;
  In* incoming_ = google::protobuf::Arena::CreateMessage<In>(&arena_);
  // Each written by one callback and read by OnDone alone, which comes last.
  bool unreadable_ = false;
  bool cancelled_ = false;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SERVER_STREAM_H_
