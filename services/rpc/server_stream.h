// The server's end of one bidirectional stream, over gRPC's callback API.
#ifndef RIPS_SERVICES_RPC_SERVER_STREAM_H_
#define RIPS_SERVICES_RPC_SERVER_STREAM_H_

#include <cstddef>
#include <cstdint>
#include <memory>

#include "google/protobuf/arena.h"
#include "google/protobuf/io/zero_copy_stream.h"
#include "grpcpp/impl/codegen/proto_utils.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/proto_buffer_reader.h"
#include "grpcpp/support/proto_buffer_writer.h"
#include "grpcpp/support/server_callback.h"
#include "services/base/check.h"
#include "services/rpc/reading_pace.h"
#include "services/rpc/stream_outbound.h"

namespace rips::rpc {

// Owned by gRPC from the handler's return until OnDone, which deletes it. Derived classes call
// Begin() last in their constructor. For gRPC its messages are bytes (WithRawCallbackMethod_NAME of
// the service), to be looked at before they are parsed.
template <typename In, typename Out>
class ServerStream : public grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer> {
 public:
  // What others hold of the stream: outlives it.
  using Outbound = StreamOutbound<ServerStream, Out>;
  const std::shared_ptr<Outbound>& outbound() const { return outbound_; }

  // For Outbound, which holds its lock and has one write at a time under way.
  void StartWrite(const Out* message) {
    bool own = false;
    const grpc::Status encoded =
        grpc::GenericSerialize<grpc::ProtoBufferWriter, Out>(*message, &outgoing_, &own);
    RIPS_CHECK(encoded.ok(), "a message that cannot be encoded");
    ServerBidiReactor::StartWrite(&outgoing_);
  }
  // For Outbound: the stream pauses.
  void Read() { StartRead(&incoming_); }

 protected:
  ServerStream() : outbound_(std::make_shared<Outbound>(this)) {}
  void Begin() { Read(); }

  // A message of `bytes` bytes has come. False: it is neither decoded nor given to OnMessage.
  virtual bool OnBytes(size_t /*bytes*/, google::protobuf::io::ZeroCopyInputStream& /*encoded*/) {
    return true;
  }
  // One message, which lives until this returns; its texts may be taken. Reactions of one stream's
  // reads never overlap.
  virtual void OnMessage(In& message) = 0;
  // That is done, and took so long. False: no more is read until outbound()->Resume(), and until
  // MayRead is true.
  virtual bool OnRead(int64_t /*took_ns*/) { return true; }
  virtual bool MayRead() { return true; }
  // The stream ends because a message of the peer could not be decoded, or because the peer
  // half-closed it, which no agent does. Before OnEnded.
  virtual void OnUnreadable() {}
  // The stream is over; nothing is called afterwards.
  virtual void OnEnded() = 0;

 private:
  void OnReadDone(bool ok) final {
    if (!ok) return EndUnreadable("the stream was half-closed, or a message was too large");
    // Its read was under way when the stream was ended.
    if (outbound_->ended()) return;
    const ReadingCost cost(incoming_.Length());
    if (!Take()) return EndUnreadable("a message cannot be decoded (is a text not UTF-8?)");
    arena_.Reset();
    incoming_.Clear();
    if (OnRead(cost.Take())) return Read();
    outbound_->Pause();
    // What it waits for may have come before it paused.
    if (MayRead()) outbound_->Resume();
  }
  // False if it cannot be decoded.
  bool Take() {
    grpc::ProtoBufferReader looked_at(&incoming_);
    if (!OnBytes(incoming_.Length(), looked_at)) return true;
    grpc::ProtoBufferReader encoded(&incoming_);
    In* message = google::protobuf::Arena::CreateMessage<In>(&arena_);
    if (!encoded.status().ok() || !message->ParseFromZeroCopyStream(&encoded)) return false;
    OnMessage(*message);
    return true;
  }
  void EndUnreadable(const char* why) {
    arena_.Reset();  // what could not be decoded may be large
    incoming_.Clear();
    unreadable_ = outbound_->open();
    outbound_->Close(grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, why));
  }
  void OnWriteDone(bool ok) final {
    outgoing_.Clear();
    outbound_->OnWritten(ok);
  }
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
  grpc::ByteBuffer incoming_;
  grpc::ByteBuffer outgoing_;  // being written
  // Of one message. The parts of a batch are hundreds.
  google::protobuf::Arena arena_;
  // Each written by one callback and read by OnDone alone, which comes last.
  bool unreadable_ = false;
  bool cancelled_ = false;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SERVER_STREAM_H_
