// Announces this participant to the ROS tools of a bus: one node that owns all its endpoints.
// Without it they show our endpoints as `_NODE_NAME_UNKNOWN_`, as they show an intruder's.
//
// | what changes                          | the claim is published                           |
// |---------------------------------------|--------------------------------------------------|
// | the first time                        | by Create, without endpoints if there are none   |
// | an endpoint comes or goes             | by the next Poll, but no sooner after the last   |
// |                                       | claim than kClaimInterval, and kEndpointInterval |
// |                                       | for each endpoint that it lists                  |
// | most processes speak another gid form | the same; the claim after it waits               |
// |                                       | kFormInterval                                    |
//
// So an endpoint is without a node on the bus for as long as its owner takes to call Poll, and in
// a burst for the interval. The claim is latched: who comes later is given the newest.
#ifndef RIPS_SERVICES_DDS_NODE_ANNOUNCER_H_
#define RIPS_SERVICES_DDS_NODE_ANNOUNCER_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/gid_form.h"
#include "services/ros2/guid.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/mutex.h"

namespace rips::dds {

struct NodeAnnouncerOptions {
  std::string node_namespace = "/";
  std::string node_name = "rips";
  // Nullopt = as most of the others do; `initial` until a claim is heard.
  std::optional<ros2::GidBytes> gid_bytes;
  ros2::GidBytes initial = ros2::GidBytes::k24;
  // Reads the claims of others itself; otherwise Heard and Gone report them.
  bool listen = false;
};

// As `dds: {gid_bytes}` says.
NodeAnnouncerOptions AnnouncerOptions(const DdsSettings& settings);

// Heard and Gone: any thread; the rest: one thread. Must not outlive its participant.
class NodeAnnouncer {
 public:
  static constexpr int64_t kClaimIntervalNs = 50'000'000;
  // A claim is as long as its list: to each reader at most 12 KB/s.
  static constexpr int64_t kEndpointIntervalNs = 2'000'000;
  // After a change of form, so that no peer can make the form flap.
  static constexpr int64_t kFormIntervalNs = 1'000'000'000;

  // PermissionDenied if the permissions of a secured participant do not let it write
  // ros_discovery_info; the middleware's errors. If it may not read the claims of others, `initial`
  // stands, and reading_status() says why.
  static absl::StatusOr<std::unique_ptr<NodeAnnouncer>> Create(const Participant& participant,
                                                               NodeAnnouncerOptions options,
                                                               int64_t now_ns);

  // `participant` has published this claim. Those of the same node name as ours follow others, too,
  // and do not count: two agents would else keep each other in the wrong form.
  void Heard(const ros2::Guid& participant, absl::string_view claim) ABSL_LOCKS_EXCLUDED(mu_);
  void Gone(const ros2::Guid& participant) ABSL_LOCKS_EXCLUDED(mu_);

  // Publishes what is due. A failed write is due again after the interval. Times are
  // CLOCK_BOOTTIME in nanoseconds.
  absl::Status Poll(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // When Poll will publish what has changed; INT64_MAX = nothing has.
  int64_t NextDue() const ABSL_LOCKS_EXCLUDED(mu_);

  ros2::GidBytes form() const ABSL_LOCKS_EXCLUDED(mu_);
  const absl::Status& reading_status() const { return reading_status_; }
  // Claims published so far.
  uint64_t published() const { return published_; }

 private:
  NodeAnnouncer(const Participant& participant, NodeAnnouncerOptions options);

  bool Changed() const ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Publish(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  void ForgetThoseWhoLeft() ABSL_LOCKS_EXCLUDED(mu_);

  const NodeAnnouncerOptions options_;
  const ros2::Guid participant_;
  // What a claim of our node has behind the participant's gid.
  const std::string name_bytes_;
  const std::shared_ptr<OwnEndpoints> endpoints_;

  mutable Mutex mu_;
  ros2::GidFormVotes votes_ ABSL_GUARDED_BY(mu_);
  // A peer has used another form than ours since the last Poll.
  bool dissent_ ABSL_GUARDED_BY(mu_) = false;

  absl::Status reading_status_;
  uint64_t published_ = 0;
  // As published last.
  uint64_t revision_ = 0;
  ros2::GidBytes published_form_ = ros2::GidBytes::k24;
  int64_t next_ns_ = 0;

  std::unique_ptr<RawWriter> writer_;
  std::unique_ptr<RawReader> reader_;  // last: goes first, then no callback runs
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_NODE_ANNOUNCER_H_
