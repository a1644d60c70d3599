#pragma once

#include "Containers/Ticker.h"
#include "Core/Arm.h"
#include "CoreMinimal.h"
#include "Delegates/Delegate.h"

class IWebSocket;

DECLARE_MULTICAST_DELEGATE_OneParam(FArmbridgeEvent, const Armbridge::FEvent&);

/** A WebSocket to a server that connects again by itself, and the conversation on it. */
class FArmbridgeConnection : public TSharedFromThis<FArmbridgeConnection>
{
public:
	FArmbridgeConnection(const FString& InUrl, const FString& InToken);
	~FArmbridgeConnection();

	/** Opens the first connection; the constructor cannot, because a delegate needs the shared pointer. */
	void Open();

	bool IsOpen() const;
	bool Send(const std::string& Frame);

	Armbridge::FArm Arm;
	FArmbridgeEvent OnEvent;

private:
	void Release();
	void HandleConnected();
	void HandleError(const FString& Error);
	void HandleClosed(int32 Code, const FString& Reason, bool bWasClean);
	void HandleMessage(const FString& Text);
	void Broadcast(const std::vector<Armbridge::FEvent>& Events);
	void ConnectLater();

	const FString Url;
	const FString Token;
	TSharedPtr<IWebSocket> Socket;
	FTSTicker::FDelegateHandle Waiting;
	double DelayS = Armbridge::FirstDelayS;
};
