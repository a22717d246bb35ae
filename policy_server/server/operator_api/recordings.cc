// Recordings: of a robot from now on, and what was saved with an alert.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/operator_api/record_tap.h"
#include "policy_server/server/operator_api/watch_stream.h"
#include "services/base/status_macros.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::operator_api {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using rips::v1::FilePiece;
using rips::v1::Recording;
using rpc::OperatorRole;

// A recording on its way from its file. On the thread for reads.
class StoredRecording {
 public:
  using Outbound = WatchStream<FilePiece>::Outbound;

  StoredRecording(std::shared_ptr<Outbound> outbound, const flight::FlightFiles* files,
                  std::string alert, std::function<void(const absl::Status&)> on_failed)
      : outbound_(std::move(outbound)),
        files_(*files),
        alert_(std::move(alert)),
        on_failed_(std::move(on_failed)) {}

  // Sends what one read may take; to be called again when all of it has been written.
  void Send() {
    queued_ = false;
    if (!outbound_->open()) return;
    const absl::Status sent = SendSome();
    if (sent.ok()) return;
    if (on_failed_) on_failed_(sent);
    outbound_->CloseWhenSent(rpc::ToGrpc(sent));
  }
  // True once until Send.
  bool Queue() { return !queued_.exchange(true); }

 private:
  static constexpr size_t kBytesAtOnce = size_t{256} << 10;

  absl::Status SendSome() {
    if (file_.get() < 0) {
      RIPS_ASSIGN_OR_RETURN(const std::string path, files_.Find(alert_));
      file_ = UniqueFd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
      struct stat about = {};
      if (file_.get() < 0 || fstat(file_.get(), &about) != 0 || !S_ISREG(about.st_mode)) {
        return absl::NotFoundError("its recording is gone from the server's disk");
      }
      left_bytes_ = file_bytes_ = static_cast<uint64_t>(about.st_size);
    }
    FilePiece piece;
    piece.set_file_bytes(file_bytes_);
    std::string& data = *piece.mutable_data();
    data.resize(std::min<uint64_t>(left_bytes_, kBytesAtOnce));
    if (!data.empty() &&
        read(file_.get(), data.data(), data.size()) != static_cast<ssize_t>(data.size())) {
      return absl::DataLossError("its recording cannot be read from the server's disk");
    }
    left_bytes_ -= data.size();
    if (outbound_->Send(std::move(piece)) && left_bytes_ == 0) {
      outbound_->CloseWhenSent(grpc::Status::OK);
    }
    return absl::OkStatus();
  }

  const std::shared_ptr<Outbound> outbound_;
  const flight::FlightFiles& files_;
  const std::string alert_;
  const std::function<void(const absl::Status&)> on_failed_;
  UniqueFd file_;
  uint64_t file_bytes_ = 0;
  uint64_t left_bytes_ = 0;
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

grpc::ServerWriteReactor<FilePiece>* OperatorService::GetAlertRecording(
    grpc::CallbackServerContext* context, const rips::v1::GetAlertRecordingRequest* request) {
  const auto who =
      AuthorizeOrder(context, "GetAlertRecording", *request, OperatorRole::kOperator, Use::kStream);
  if (!who.ok()) return RefuseWatch<FilePiece>(who.status());
  if (access_.recordings == nullptr) {
    return RefuseWatch<FilePiece>(
        absl::NotFoundError("this server keeps no recordings (`recordings: {keep: 0B}`)"));
  }
  auto* stream = new WatchStream<FilePiece>();
  Keep(rpc::StreamKind::kRecord, stream, *who, context);
  const auto outbound = stream->outbound();
  // The request may be gone by then.
  std::function<void(const absl::Status&)> on_failed;
  if (access_.audit != nullptr) {
    on_failed = [audit = access_.audit, caller = rpc::Describe(*who), address = context->peer(),
                 asked = *request](const absl::Status& why) {
      audit->Record({.caller = caller,
                     .address = address,
                     .call = "GetAlertRecording",
                     .request = asked,
                     .status = why});
    };
  }
  const auto stored = std::make_shared<StoredRecording>(outbound, access_.recordings,
                                                        request->alert_id(), std::move(on_failed));
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
