// The ApproximateTime policy of ROS message_filters on a recording, fed in recorded order; nothing is sent.
// Standard input: the tolerance in nanoseconds and the queue size, then one "ARRIVED STREAM TIME" a line (nanoseconds; streams 0, 1, 2).
// Standard output: one "GIVEN TIME0 TIME1 TIME2" a set.
#include <message_filters/simple_filter.h>
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/synchronizer.h>
#include <ros/message_traits.h>
#include <ros/time.h>

#include <boost/make_shared.hpp>
#include <cstdint>
#include <cstdio>

struct Message {
  std::int64_t time;
};

static ros::Time instant(std::int64_t nanos) { return ros::Time(nanos / 1000000000, nanos % 1000000000); }

namespace ros {
namespace message_traits {
template <>
struct TimeStamp<Message, void> {
  static ros::Time value(const Message& message) { return instant(message.time); }
};
}  // namespace message_traits
}  // namespace ros

struct Filter : message_filters::SimpleFilter<Message> {
  void put(std::int64_t time, std::int64_t arrived) {
    const boost::shared_ptr<Message const> message = boost::make_shared<Message>(Message{time});
    signalMessage(ros::MessageEvent<Message const>(message, instant(arrived)));
  }
};

typedef message_filters::sync_policies::ApproximateTime<Message, Message, Message> Policy;
typedef boost::shared_ptr<Message const> Pointer;

static long long now = 0;

static void given(const Pointer& first, const Pointer& second, const Pointer& third) {
  std::printf("%lld %lld %lld %lld\n", now, static_cast<long long>(first->time), static_cast<long long>(second->time),
              static_cast<long long>(third->time));
}

int main() {
  ros::Time::init();
  long long tolerance;
  int queue_items;
  if (std::scanf("%lld %d", &tolerance, &queue_items) != 2) return 2;
  Filter filters[3];
  Policy policy(queue_items);
  policy.setMaxIntervalDuration(ros::Duration().fromNSec(tolerance));
  message_filters::Synchronizer<Policy> synchronizer(static_cast<const Policy&>(policy), filters[0], filters[1], filters[2]);
  synchronizer.registerCallback(given);
  int stream;
  long long time;
  while (std::scanf("%lld %d %lld", &now, &stream, &time) == 3) {
    ros::Time::setNow(instant(now));
    filters[stream].put(time, now);
  }
}
