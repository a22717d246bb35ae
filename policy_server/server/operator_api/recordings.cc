// Recordings: of a robot from now on, and what was saved with an alert.
#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/operator_api/record_tap.h"
#include "policy_server/server/operator_api/watch_stream.h"
#include "services/base/status_macros.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using rips::v1::Recording;
using rpc::OperatorRole;

// A recording on its way from its file. On the thread for reads.
class StoredRecording {
 public:
  using Outbound = WatchStream<Recording>::Outbound;

  StoredRecording(std::shared_ptr<Outbound> outbound, const flight::FlightFiles* files,
                  std::string alert)
      : outbound_(std::move(outbound)), files_(*files), alert_(std::move(alert)) {}

  // Sends what one read may take; to be called again when all of it has been written.
  void Send() {
    queued_ = false;
    if (!outbound_->open()) return;
    const absl::Status sent = SendSome();
    if (!sent.ok()) outbound_->CloseWhenSent(rpc::ToGrpc(sent));
  }
  // True once until Send.
  bool Queue() { return !queued_.exchange(true); }

 private:
  static constexpr size_t kBytesAtOnce = size_t{256} << 10;

  absl::Status SendSome() {
    if (reader_ == nullptr) {
      RIPS_ASSIGN_OR_RETURN(const std::string path, files_.Find(alert_));
      RIPS_ASSIGN_OR_RETURN(reader_, recording::OpenFile(path));
      Recording first;
      *first.mutable_header() = recording::EncodeHeader(*reader_->origin());
      outbound_->Send(std::move(first));
    }
    for (size_t bytes = 0; bytes < kBytesAtOnce;) {
      RIPS_ASSIGN_OR_RETURN(const std::optional<recording::Recorded> event, reader_->Next());
      if (!event.has_value()) {
        outbound_->CloseWhenSent(grpc::Status::OK);
        return absl::OkStatus();
      }
      Recording piece;
      *piece.mutable_event() = recording::EncodeEvent(*event);
      bytes += piece.ByteSizeLong();
      if (!outbound_->Send(std::move(piece))) return absl::OkStatus();
    }
    return absl::OkStatus();
  }

  const std::shared_ptr<Outbound> outbound_;
  const flight::FlightFiles& files_;
  const std::string alert_;
  std::unique_ptr<recording::Reader> reader_;
  std::atomic<bool> queued_ = false;
};

}  // namespace

grpc::ServerWriteReactor<Recording>* OperatorService::Record(
    grpc::CallbackServerContext* context, const rips::v1::RecordRequest* request) {
  const auto who =
      AuthorizeOrder(context, "Record", *request, OperatorRole::kOperator, Use::kStream);
  if (!who.ok()) return RefuseWatch<Recording>(who.status());
  LogInfo("operator starts a recording",
          {{"operator", rpc::Describe(*who)}, {"robot", request->robot()}});
  auto* stream = new WatchStream<Recording>();
  Keep(rpc::StreamKind::kRecord, stream, *who, context);
  auto outbound = stream->outbound();
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders, [outbound](Robot& robot) {
        auto tap = std::make_shared<RecordingWriter>(
            [outbound](Recording piece) { return outbound->Send(std::move(piece)); },
            [outbound] { return outbound->open(); });
        if (const absl::Status added = robot.AddTap(tap); !added.ok()) {
          return outbound->Close(rpc::ToGrpc(added));
        }
        const pipeline::RobotStatus status = robot.Status();
        rips::v1::RecordingHeader header;
        header.set_robot(robot.id());
        header.set_bundle_id(status.bundle_version);
        header.set_level(status.decided_level);
        header.set_start_unix_ns(RealClock().Now().unix_ns);
        header.set_rips_version(std::string(RipsVersion()));
        tap->Start(std::move(header), robot.core().graph_version().graph,
                   robot.core().judge().graph_changed_unix_ns() != 0);
      });
  if (!posted.ok()) outbound->Close(rpc::ToGrpc(posted));
  return stream;
}

grpc::ServerWriteReactor<Recording>* OperatorService::GetAlertRecording(
    grpc::CallbackServerContext* context, const rips::v1::GetAlertRecordingRequest* request) {
  const auto who =
      AuthorizeOrder(context, "GetAlertRecording", *request, OperatorRole::kOperator, Use::kStream);
  if (!who.ok()) return RefuseWatch<Recording>(who.status());
  if (access_.recordings == nullptr) {
    return RefuseWatch<Recording>(
        absl::NotFoundError("this server keeps no recordings (`recordings: {keep: 0B}`)"));
  }
  auto* stream = new WatchStream<Recording>();
  Keep(rpc::StreamKind::kRecord, stream, *who, context);
  const auto outbound = stream->outbound();
  const auto stored =
      std::make_shared<StoredRecording>(outbound, access_.recordings, request->alert_id());
  const auto send = [this, outbound, stored] {
    if (!stored->Queue() || reads_.Push([stored] { stored->Send(); })) return;
    outbound->Close(
        rpc::ToGrpc(absl::ResourceExhaustedError("too many reads wait already; try again later")));
  };
  stream->set_on_drained(send);
  send();
  return stream;
}

}  // namespace rips::operator_api
