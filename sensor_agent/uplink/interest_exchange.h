// Which interest of the server is observed, and what each stream's offers are answered with.
#ifndef RIPS_SENSOR_AGENT_UPLINK_INTEREST_EXCHANGE_H_
#define RIPS_SENSOR_AGENT_UPLINK_INTEREST_EXCHANGE_H_

#include <optional>
#include <string>
#include <vector>

#include "rips/v1/sensor.pb.h"

namespace rips::sensor {

// Not thread-safe.
class InterestExchange {
 public:
  // The server offers the interest of this id. False: it was handed on already; the answer is
  // queued if it is observed, and comes otherwise with InUse.
  bool Offered(const std::string& id);
  void HandedOn(const std::string& id) { handed_on_ = id; }
  // The interest cannot be observed.
  void Rejected(const std::string& id, const std::string& problem) { Answer(id, problem); }
  // The interest is observed from now on.
  void InUse(const std::string& id);

  // Empty = none yet. It outlives streams, so that watching goes on while the server is away.
  const std::string& in_use() const { return in_use_; }

  // A stream's answers go with it.
  void StreamBegan();
  void StreamEnded();
  // The oldest answer; null = none.
  const rips::v1::InterestApplied* Front() const;
  void PopFront() { answers_.erase(answers_.begin()); }

 private:
  void Answer(const std::string& id, const std::string& problem);

  std::string in_use_;
  // The newest.
  std::string handed_on_;
  bool has_stream_ = false;
  std::vector<rips::v1::InterestApplied> answers_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_INTEREST_EXCHANGE_H_
